// A ball as one camera sees it, and the first intersection of a ray with it.
#pragma once

#include <nanobind/stl/tuple.h>

#include "spheremouse/geometry/camera.h"

namespace spheremouse::ball {

struct BallView {
    Vector<3> centre;    // m, of the ball, obj
    double radius;       // m
    double disc_angle;   // rad, angular radius of a disc
    Matrix<3> rotation;  // R_obj_cam
    Vector<3> position;  // m, of the camera, obj
    Camera camera;
    double readout;         // s, time a rolling shutter takes over all rows
    Matrix<10> covariance;  // of the errors common to all frames, pose and ball: m, rad
    Vector<3> focal_turn;   // rad, turn of the axes of obj by a relative change of the focal length
};

/// Read a `rig.BallView`.
inline BallView read_ball_view(nb::handle view_) {
    const nb::tuple view = members(view_, 12, "view");
    const auto scalar = [&](int i) { return number<double>(view[i], "view"); };
    const auto [fx, fy, cx, cy] = number<std::tuple<double, double, double, double>>(view[5], "view");
    const auto k = vector<5>(view[6], "distortion");
    return {vector<3>(view[0], "centre"),
            scalar(1),
            scalar(2),
            matrix<3, 3>(view[3], "rotation"),
            vector<3>(view[4], "position"),
            Camera{fx, fy, cx, cy, k(0), k(1), k(2), k(3), k(4), scalar(7), number<int>(view[8], "view")},
            scalar(9),
            matrix<10, 10>(view[10], "covariance"),
            vector<3>(view[11], "focal_turn")};
}

constexpr double HANDS_STAY = 1.0;  // s, after which a hand has moved

/// Return how far a disc moves in `dt` s, in its diameters. A hand in front of it moves as far in a while.
///
/// `rate`, rad/s, and `direction` have the same axes.
inline double moved_from_cover(const Vector<3>& rate, const Vector<3>& direction, double dt, double disc_angle) {
    return dt * (rate.cross(direction).norm() / (2.0 * disc_angle) + 1.0 / HANDS_STAY);
}

/// A point of the ball at position + scale * ray, with a ray of unit depth in cam, written in obj.
struct Hit {
    Vector<3> ray, point;  // obj, m
    double scale;
    bool met;  // false if the ray misses the ball
};

/// Return the nearer of two points on the ray of reduced coordinates (Wittich 2017, eq. 110-113).
inline Hit first_hit(const BallView& view, const Vector<2>& xy) {
    const Vector<3> ray = view.rotation * xy.homogeneous(), to = view.centre - view.position;
    const double a = ray.squaredNorm(), b = ray.dot(to),
                 root = b * b - a * (to.squaredNorm() - view.radius * view.radius);
    if (!(root > 0.0 && b > 0.0)) return {ray, ray, 0.0, false};  // nan of a pixel without a ray is a miss
    const double scale = (b - std::sqrt(root)) / a;
    return {ray, view.position + scale * ray, scale, true};
}

}  // namespace spheremouse::ball
