#include "spheremouse/geometry/rotation.h"

namespace spheremouse {
namespace {

/// Apply a function of one vector to rows of (n, 3): return (n, 3, 3).
template <Matrix<3> (*F)(const Vector<3>&)>
NewArray<double> of_vectors(nb::handle v_) {
    const auto v = matrix<Dynamic, 3>(v_, "v");
    const Rows<3, 3> M(size_t(v.rows()));
    for (nb::ssize_t i = 0; i < v.rows(); i++) M[size_t(i)] = F(v.row(i).transpose());
    return M.array;
}

NewArray<double> of_matrices(nb::handle R_) {
    const auto R = array<const double, -1, 3, 3>(R_, "R");
    const Rows<3> v(R.shape(0));
    for (size_t i = 0; i < R.shape(0); i++) v[i] = log(View<3, 3>(R.data() + 9 * i));
    return v.array;
}

}  // namespace

void bind_rotation(nb::module_& m) {
    m.def("exp", &of_vectors<&exp>, arg("v"));
    m.def("log", &of_matrices, arg("R"));
    m.def("left_jacobian", &of_vectors<&left_jacobian>, arg("v"));
}

}  // namespace spheremouse
