// Rotation vectors and matrices, as `rotation.py` has them (Sola 2018, "A micro Lie theory", appendix B).
#pragma once

#include "spheremouse/native/matrices.h"

namespace spheremouse {

/// Return one I + a hat(v) + b v v'.
inline Matrix<3> about(const Vector<3>& v, double one, double a, double b) {
    Matrix<3> M = b * v * v.transpose();
    M.diagonal().array() += one;
    M(0, 1) -= a * v(2);
    M(1, 0) += a * v(2);
    M(0, 2) += a * v(1);
    M(2, 0) -= a * v(1);
    M(1, 2) -= a * v(0);
    M(2, 1) += a * v(0);
    return M;
}

/// Return the matrix of the cross product v x.
inline Matrix<3> hat(const Vector<3>& v) { return about(v, 0.0, 1.0, 0.0); }

/// Return (1 - cos angle) / angle², the coefficient of hat(v)² in the series of both functions below.
inline double half_square(double square, double angle, bool small) {
    return small ? 0.5 - square / 24.0 : 2.0 * std::pow(std::sin(0.5 * angle) / angle, 2);
}

/// Return the rotation matrix of a vector, rad.
inline Matrix<3> exp(const Vector<3>& v) {
    const double square = v.squaredNorm(), angle = std::sqrt(square);
    const bool small = angle <= 1e-6;  // below it series of two terms are exact to double precision
    const double b = half_square(square, angle, small);
    return about(v, 1.0 - b * square, small ? 1.0 - square / 6.0 : std::sin(angle) / angle, b);
}

/// Return the rotation vector of a matrix, length in [0, pi], by the unit quaternion (Shepperd 1978).
inline Vector<3> log(const Matrix<3>& R) {
    const Eigen::Quaterniond q(R);
    const double s = q.vec().norm(), w = q.w() < 0.0 ? -q.w() : q.w(), sign = q.w() < 0.0 ? -1.0 : 1.0;
    return sign * (s < 1e-6 ? 2.0 : 2.0 * std::atan2(s, w) / s) * q.vec();
}

/// Return J with exp(v + d) = exp(J d) exp(v), to first order in d.
inline Matrix<3> left_jacobian(const Vector<3>& v) {
    const double square = v.squaredNorm(), angle = std::sqrt(square);
    const bool small = angle < 1e-4;  // below it the cubic coefficient loses precision, and its series is exact
    const double b = small ? 1.0 / 6.0 - square / 120.0 : (angle - std::sin(angle)) / (angle * square);
    return about(v, 1.0 - b * square, half_square(square, angle, small), b);
}

/// Return two orthonormal columns perpendicular to a unit vector, as `tangent_basis` of `rotation.py` has them.
inline Matrix<3, 2> tangent_basis(const Vector<3>& u) {
    const double sign = std::copysign(1.0, u(2)), a = -1.0 / (sign + u(2)), b = u(0) * u(1) * a;
    Matrix<3, 2> E;
    E << 1.0 + sign * u(0) * u(0) * a, b, sign * b, sign + u(1) * u(1) * a, -sign * u(0), -u(1);
    return E;
}

}  // namespace spheremouse
