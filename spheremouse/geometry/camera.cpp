#include "spheremouse/geometry/camera.h"

#include <nanobind/stl/tuple.h>

namespace spheremouse {
namespace {

using Intrinsic = std::tuple<double, double, double, double>;

/// Apply a map of the plane to rows of (n, 2): return places, (n, 2), and Jacobians, (n, 2, 2).
template <Mapped<> (*F)(const Camera&, const Vector<2>&)>
nb::tuple mapped(nb::handle points, const char* name, const Intrinsic& intrinsic, nb::handle distortion, double fold) {
    const auto from = matrix<Dynamic, 2>(points, name);
    const auto k = vector<5>(distortion, "distortion");
    const auto [fx, fy, cx, cy] = intrinsic;
    const Camera camera{fx, fy, cx, cy, k(0), k(1), k(2), k(3), k(4), fold, 0};
    const size_t n = size_t(from.rows());
    const Rows<2> to(n);
    const Rows<2, 2> J(n);
    {
        nb::gil_scoped_release release;
        for (size_t i = 0; i < n; i++) {
            const Mapped<> m = F(camera, from.row(nb::ssize_t(i)).transpose());
            to[i] = m.place;
            J[i] = m.J;
        }
    }
    return nb::make_tuple(to.array, J.array);
}

}  // namespace

void bind_camera(nb::module_& m) {
    m.def(
        "distort", [](nb::handle xy, nb::handle k) { return mapped<&distort>(xy, "xy", {1.0, 1.0, 0.0, 0.0}, k, 0.0); },
        arg("xy"), arg("distortion"));
    m.def(
        "unproject",
        [](nb::handle uv, const Intrinsic& intrinsic, nb::handle k, double fold) {
            return mapped<&unproject>(uv, "uv", intrinsic, k, fold);
        },
        arg("uv"), arg("intrinsic"), arg("distortion"), arg("fold_r2"));
}

}  // namespace spheremouse
