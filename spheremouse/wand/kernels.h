// Plain structs of the wand's functions: ball, camera, fields of a picture, and the points that one pose shows.
#pragma once

#include "spheremouse/geometry/rotation.h"

namespace spheremouse::wand {

using Eigen::Matrix3d, Eigen::Vector2d, Eigen::Vector3d;
using Positions = Array<const double, -1, 3>;
using Rotations = Array<const double, -1, 3, 3>;

constexpr double SIGMA = 0.065;       // of a field's range, `likelihood.SIGMA`
constexpr double SHARP_RIM = 0.55;    // px, blur of a rim in focus: `rims.edge_blur`
constexpr double OUTLIER = 0.08;      // fraction of the points that a finger, a highlight or a stick hides
constexpr double MIN_FACING = 0.08;   // cosine of the viewing angle at which a point has weight
constexpr double FULL_FACING = 0.25;  // and full weight
constexpr double FIELD_SIGMA = 1.2;   // px of the field
constexpr size_t DIRECTIONS = 24;     // around the outline
constexpr double EDGE_SIGMA = 0.2;    // px, of one edge of the outline
constexpr double EDGE_OFFSET = 0.15;  // px, common to all edges
constexpr double EDGE_HIDDEN = 0.3;   // fraction of the outline without an edge
constexpr double PI = 3.14159265358979323846;
// Density of a false edge over the true edge's peak: the search goes 4 px to either side.
const double EDGE_UNIFORM = std::sqrt(2.0 * PI) * EDGE_SIGMA / 8.0;

struct Pose {
    Vector3d c;  // m, cam
    Matrix3d R;  // R_cam_ball
};

/// Focal lengths, principal point, then OpenCV's distortion k1, k2, p1, p2, k3.
template <class T>
struct Camera {
    T fx, fy, cx, cy, k1, k2, p1, p2, k3;

    template <class Other>
    operator Camera<Other>() const {
        return {Other(fx), Other(fy), Other(cx), Other(cy), Other(k1), Other(k2), Other(p1), Other(p2), Other(k3)};
    }

    /// Pixel of a point in cam (Wittich 2017, eq. 69-76, as in geometry.camera).
    void pixel(T x, T y, T& u, T& v) const {
        const T r2 = x * x + y * y, radial = T(1) + r2 * (k1 + r2 * (k2 + r2 * k3));
        u = fx * (x * radial + T(2) * p1 * x * y + p2 * (r2 + T(2) * x * x)) + cx;
        v = fy * (y * radial + p1 * (r2 + T(2) * y * y) + T(2) * p2 * x * y) + cy;
    }
};

/// Ball with its points before a camera: `model.Model`.
class BallModel {
  public:
    BallModel(nb::handle table, nb::handle colour, double radius, nb::handle lens);

    double radius;
    Camera<double> camera;
    size_t size;
    std::vector<float> column[12];    // direction, tangent, tangent x direction, rim, far rim, curvature (rad, rad, 1)
    std::vector<double> solid_angle;  // sr, of each disc's points, then of bare points
    std::vector<size_t> first;        // point of each disc, its centre
    std::vector<int> colour, disc;    // of each point; colour -1 of a bare one
};

/// Fields of equal size, 0 to 255.
struct Planes {
    const uint8_t* data;
    size_t count;
    int height, width;

    /// Field k at a place in px of the fields, interpolated bilinearly, 0 to 1.
    double at(int k, double x, double y) const {
        const int j = int(x), i = int(y);
        const double a = x - j, b = y - i;
        const uint8_t *p = data + (size_t(k) * size_t(height) + size_t(i)) * size_t(width) + j, *q = p + width;
        const double high = (1.0 - a) * p[0] + a * p[1], low = (1.0 - a) * q[0] + a * q[1];
        return ((1.0 - b) * high + b * low) * (1.0 / 255.0);
    }
};

/// How a colour's bounds select the rims of its discs: px outward from the true rim, its standard deviation, standard
/// deviation of the blur, least fraction of print in a selected pixel.
struct Rim {
    double offset, sigma, blur, cover;
};

/// Weight fields of part of a picture: `colour.Fields`.
class FieldsView {
  public:
    FieldsView(nb::handle weight, nb::handle glare, nb::handle place, nb::handle fraction, nb::handle rims,
               nb::handle exposure_motion);

    /// Raise a TypeError unless each colour of a ball has a field.
    void require_colours_of(const BallModel& ball) const;

    Planes weight, glare;
    double left, top, factor;
    double sigma = 0.0;            // of the field's range
    std::vector<double> fraction;  // of each colour
    std::vector<Rim> rim;          // of each colour
    Vector<6> exposure_motion;     // m, rad in cam: of the ball; 0 if unknown

  private:
    Array<const uint8_t, -1, -1, -1> arrays_[2];  // that own the planes
};

/// Points that one pose shows within the fields, each with its weight. Arrays have one value for each such point.
struct Sight {
    explicit Sight(size_t points);

    // all points of the ball: cosine of the viewing angle, px of the field, lines of sight along the rim and out of the
    // disc, px of the field per rad, depth, px of the field moved across the rim during the exposure
    std::vector<float> facing, x, y, along, outward, scale, depth, across;
    std::vector<double> disc_weight;
    // visible points: index; weight; px of the field; glare; for coloured ones field m, expected field e, residual r,
    // de / d(rim offset) g, and the arguments of e
    size_t coloured = 0, bare = 0;
    std::vector<size_t> index, bare_index;
    std::vector<double> w, hidden, m, r, bare_w, bare_x, bare_y;
    std::vector<float> e, g, argument[9];
};

/// Measure the points that a pose shows. `disc_weight` has the weight of the points of each disc, null for its own.
void measure(const BallModel& ball, const FieldsView& fields, const Pose& pose, const double* disc_weight, Sight& s);

/// Return two columns across the line of sight to c and one along it. A move along the third moves no image point.
inline Matrix3d ray_basis(const Vector3d& c) {
    Matrix3d B;
    B.col(0) = Vector3d(c[2], 0.0, -c[0]) / std::sqrt(c[0] * c[0] + c[2] * c[2]);
    B.col(2) = c / c.norm();
    B.col(1) = B.col(2).cross(B.col(0));
    return B;
}

/// Return point k of the outline of a ball at c, m from the centre, in cam.
Vector3d outline_point(const Vector3d& c, double radius, size_t k);

/// Return the pixel of a point in cam.
inline Vector2d pixel(const Camera<double>& camera, const Vector3d& p) {
    Vector2d uv;
    camera.pixel(p[0] / p[2], p[1] / p[2], uv[0], uv[1]);
    return uv;
}

}  // namespace spheremouse::wand
