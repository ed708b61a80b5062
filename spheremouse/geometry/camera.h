// Camera model, as `camera.py` has it: pinhole with OpenCV's five distortion terms (Wittich 2017, eq. 69-76).
#pragma once

#include <limits>

#include "spheremouse/native/matrices.h"

namespace spheremouse {

/// Interior orientation, for images of one size.
struct Camera {
    double fx, fy, cx, cy;      // px
    double k1, k2, p1, p2, k3;  // in OpenCV's order
    double fold_r2;             // squared reduced radius beyond which a pixel has no ray
    int height;                 // px
};

/// A place with its Jacobian by the place that was mapped.
template <int N = 2>
struct Mapped {
    Vector<2> place;
    Matrix<2, N> J;
};

/// Distort ideal reduced coordinates x/z, y/z. The Jacobian is symmetric.
inline Mapped<> distort(const Camera& c, const Vector<2>& xy) {
    const double x = xy(0), y = xy(1), r2 = x * x + y * y, radial = 1.0 + r2 * (c.k1 + r2 * (c.k2 + r2 * c.k3));
    const double slope = 2.0 * (c.k1 + r2 * (2.0 * c.k2 + 3.0 * r2 * c.k3));  // d radial / d x = slope x
    const double across = slope * x * y + 2.0 * c.p1 * x + 2.0 * c.p2 * y;
    Mapped<> m;
    m.place << x * radial + 2.0 * c.p1 * x * y + c.p2 * (r2 + 2.0 * x * x),
        y * radial + c.p1 * (r2 + 2.0 * y * y) + 2.0 * c.p2 * x * y;
    m.J << radial + slope * x * x + 2.0 * c.p1 * y + 6.0 * c.p2 * x, across, across,
        radial + slope * y * y + 6.0 * c.p1 * y + 2.0 * c.p2 * x;
    return m;
}

/// Undistort reduced coordinates by Newton's method, with the Jacobian of `distort` there.
///
/// If no ray maps to them, the result is nan: the method does not converge, or the squared radius exceeds the fold.
inline Mapped<> undistort(const Camera& c, const Vector<2>& uv) {
    Vector<2> xy = uv;
    double step = std::numeric_limits<double>::infinity();
    for (int round = 0; round < 30; round++) {
        const Mapped<> m = distort(c, xy);
        const double det = m.J.determinant();
        if (!(std::abs(det) > 1e-9)) break;
        const Vector<2> left = uv - m.place;
        const double dx = (m.J(1, 1) * left(0) - m.J(0, 1) * left(1)) / det;
        const double dy = (m.J(0, 0) * left(1) - m.J(0, 1) * left(0)) / det;
        step = std::hypot(dx, dy);
        xy +=
            std::min(1.0, 0.3 / std::max(step, 1e-300)) * Vector<2>(dx, dy);  // a limited step stays on the near branch
        if (!(step > 1e-13)) break;
    }
    const Matrix<2> J = distort(c, xy).J;
    if (!(step < 1e-9) || J.determinant() <= 0.0 || xy.squaredNorm() >= c.fold_r2)
        return {Vector<2>::Constant(std::nan("")), Matrix<2>::Identity()};
    return {xy, J};
}

/// Project a point in cam, m, to a pixel. A point at or behind the projection centre gives nan.
inline Mapped<3> project(const Camera& c, const Vector<3>& point) {
    const double z = point(2) > 0.0 ? point(2) : std::nan("");
    const Vector<2> f(c.fx, c.fy), xy = point.head<2>() / z;
    const Mapped<> m = distort(c, xy);
    Matrix<2, 3> reduced;
    reduced << 1.0 / z, 0.0, -xy(0) / z, 0.0, 1.0 / z, -xy(1) / z;
    return {Vector<2>(m.place.cwiseProduct(f) + Vector<2>(c.cx, c.cy)), f.asDiagonal() * m.J * reduced};
}

/// Convert a pixel to ideal reduced coordinates. A pixel to which no ray maps gives nan.
inline Mapped<> unproject(const Camera& c, const Vector<2>& uv) {
    const Mapped<> m = undistort(c, Vector<2>((uv(0) - c.cx) / c.fx, (uv(1) - c.cy) / c.fy));
    const double det = m.J.determinant();
    Matrix<2> J;
    J << m.J(1, 1) / det / c.fx, -m.J(0, 1) / det / c.fy, -m.J(0, 1) / det / c.fx, m.J(0, 0) / det / c.fy;
    return {m.place, J};
}

/// Return the readout time of row v as a fraction of all rows, from -1/2 at the top to 1/2 at the bottom.
inline double row_of(const Camera& c, double v) { return (v + 0.5) / c.height - 0.5; }

}  // namespace spheremouse
