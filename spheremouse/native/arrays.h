// What the native functions share: typed arrays that name the argument if they are wrong, and new arrays.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

namespace nb = nanobind;

namespace spheremouse {

using nb::arg;

template <class T, nb::ssize_t... Shape>
using Array = nb::ndarray<T, nb::shape<Shape...>, nb::c_contig, nb::device::cpu>;  // a size of -1 is free

/// Compiled twice for x86-64, by GCC alone: Clang's copies call no function that returns a wide vector. Without fused
/// operations, wider registers give the same results.
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

/// Return an argument as an array without copying. Raise a TypeError that names it if type, shape or order is wrong.
template <class T, nb::ssize_t... Shape>
Array<T, Shape...> array(nb::handle given, const char* name) {
    Array<T, Shape...> result;
    if (nb::try_cast(given, result, false)) return result;
    std::string shape;
    ((shape += (shape.empty() ? "" : ", ") + (Shape < 0 ? "n" : std::to_string(Shape))), ...);
    const char kind = std::is_floating_point_v<T> ? 'f' : std::is_unsigned_v<T> ? 'u' : 'i';
    const nb::object dtype = nb::getattr(given, "dtype", nb::none()), sizes = nb::getattr(given, "shape", nb::none());
    throw nb::type_error((std::string(name) + ": must be an array of type " + kind + std::to_string(sizeof(T)) +
                          " and shape (" + shape + ") in C order, is " + nb::str(dtype).c_str() + " " +
                          nb::str(sizes).c_str())
                             .c_str());
}

/// Return a tuple as it is. Raise a TypeError that names it if it has another number of members.
inline nb::tuple members(nb::handle given, size_t count, const char* name) {
    if (nb::isinstance<nb::tuple>(given) && nb::len(given) == count) return nb::borrow<nb::tuple>(given);
    throw nb::type_error((std::string(name) + ": must be a tuple of " + std::to_string(count) + " members").c_str());
}

/// Return a member of a tuple as a number. Raise a TypeError that names the tuple if it is none.
template <class T>
T number(nb::handle given, const char* name) {
    T result;
    if (nb::try_cast(given, result)) return result;
    throw nb::type_error((std::string(name) + ": must have a number of another type").c_str());
}

/// Ask for n bytes from memory, while other work goes on.
inline void prefetch(const uint8_t* from, int n) {
    constexpr int CACHE_LINE = 64;  // bytes
    for (int i = 0; i < n; i += CACHE_LINE) __builtin_prefetch(from + i);
}

/// `numpy.zeros`, and NumPy's types of elements: what the module looks up once.
inline nb::handle numpy_zeros;
template <class T>
inline nb::handle dtype;

/// A new array of NumPy, filled with zeros. NumPy makes one in a third of the time that an export of nanobind takes.
template <class T>
class NewArray : public nb::object {
    T* data_;

  public:
    explicit NewArray(nb::object array) : nb::object(std::move(array)) {
        Py_buffer buffer;
        if (PyObject_GetBuffer(ptr(), &buffer, PyBUF_WRITABLE) != 0) throw nb::python_error();
        data_ = static_cast<T*>(buffer.buf);
        PyBuffer_Release(&buffer);
    }

    T* data() const { return data_; }
};

template <class T>
NewArray<T> zeros(std::initializer_list<size_t> shape) {
    const nb::tuple sizes = nb::steal<nb::tuple>(PyTuple_New(Py_ssize_t(shape.size())));
    for (size_t i = 0; i < shape.size(); i++)
        PyTuple_SetItem(sizes.ptr(), Py_ssize_t(i), PyLong_FromSize_t(shape.begin()[i]));
    return NewArray<T>(numpy_zeros(sizes, dtype<T>));
}

}  // namespace spheremouse
