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

/// Return a new array of NumPy, filled with zeros.
template <class T, size_t N>
nb::ndarray<nb::numpy, T> zeros(const size_t (&shape)[N]) {
    size_t size = 1;
    for (size_t n : shape) size *= n;
    T* data = new T[size]();
    nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<T*>(p); });
    return nb::ndarray<nb::numpy, T>(data, N, shape, owner);
}

}  // namespace spheremouse
