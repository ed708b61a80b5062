// Projection of discs on the ball to ellipses in pixels, as `appearance.py` describes it.
#include "spheremouse/ball/detect/disc_model.h"

namespace spheremouse::ball {
namespace {

constexpr int CORNERS = 24;  // of the polygon that approximates a distorted outline

/// Return the centroid of an ellipse's distorted outline relative to `middle`, where its centre is.
Vector<2> distorted_centroid(const Camera& camera, const Vector<2>& centre, const Shape& S, const Vector<2>& middle) {
    static const auto circle = [] {
        std::vector<Vector<2>> points;
        for (int i = 0; i <= CORNERS; i++) {
            const double angle = 2.0 * M_PI * (i % CORNERS) / CORNERS;
            points.emplace_back(std::cos(angle), std::sin(angle));
        }
        return points;
    }();
    const double l11 = std::sqrt(S(0, 0)), l21 = S(0, 1) / l11, l22 = std::sqrt(std::max(S(1, 1) - l21 * l21, 0.0));
    Vector<2> p, sum = Vector<2>::Zero();
    double total = 0.0;
    for (int i = 0; i <= CORNERS; i++) {
        const Vector<2> corner(l11 * circle[i](0), l21 * circle[i](0) + l22 * circle[i](1));
        const Vector<2> q = distort(camera, centre + corner).place - middle;
        if (i > 0) {
            const double cross = p(0) * q(1) - q(0) * p(1);
            total += cross;
            sum += cross * (p + q);
        }
        p = q;
    }
    return sum / (3.0 * total);
}

nb::tuple appearance_(nb::handle directions_, nb::handle view_) {
    const auto directions = array<const double, -1, 3>(directions_, "directions");
    const BallView view = read_ball_view(view_);
    const size_t n = directions.shape(0);
    const Rows<2> centre(n), centroid(n);
    const Rows<2, 2> shape(n);
    auto area = zeros<double>({n});
    auto whole = zeros<bool>({n});
    for (size_t i = 0; i < n; i++) {
        const Appearance a = appearance(view, View<3, 1>(&directions(i, 0)));
        centre[i] = a.centre;
        centroid[i] = a.centroid;
        shape[i] = a.shape;
        area.data()[i] = a.area;
        static_cast<bool*>(whole.data())[i] = a.whole;
    }
    return nb::make_tuple(centre.array, centroid.array, shape.array, area, whole);
}

nb::object seen_at_(nb::handle directions_, nb::handle view_) {
    const auto directions = array<const double, -1, 3>(directions_, "directions");
    const BallView view = read_ball_view(view_);
    const Rows<2> uv(directions.shape(0));
    for (size_t i = 0; i < directions.shape(0); i++) uv[i] = seen_at(view, View<3, 1>(&directions(i, 0)));
    return nb::cast(uv.array);
}

}  // namespace

/// The dual conic of the projected rim is C C' - r² (I - n n') (Hartley, Zisserman 2004, section 8.3).
Appearance appearance(const BallView& view, const Vector<3>& direction) {
    const Vector<3> towards = view.position - view.centre;
    // the horizon lies where the cosine to the camera's direction is R / distance; the rim is an angle further out
    const double distance = towards.norm(), horizon = std::acos(view.radius / distance);
    if (!(direction.dot(towards) > std::cos(horizon - view.disc_angle) * distance)) {
        constexpr double NaN = std::numeric_limits<double>::quiet_NaN();
        return {Vector<2>::Constant(NaN), Vector<2>::Constant(NaN), Shape::Constant(NaN), NaN, false};
    }
    const Camera& camera = view.camera;
    const Vector<2> f(camera.fx, camera.fy), offset(camera.cx, camera.cy);
    const double r = view.radius * std::sin(view.disc_angle);
    const Vector<3> n = view.rotation.transpose() * direction, origin = -view.rotation.transpose() * towards;
    const Vector<3> c = origin + view.radius * std::cos(view.disc_angle) * n, top = origin + view.radius * n;
    const Matrix<3> D = c * c.transpose() - r * r * (Matrix<3>::Identity() - n * n.transpose());
    const Vector<2> middle = D.topRightCorner<2, 1>() / D(2, 2);
    const Shape reduced = middle * middle.transpose() - D.topLeftCorner<2, 2>() / D(2, 2);
    const Mapped<> m = distort(camera, middle);
    Appearance a;
    a.whole = true;
    a.centre = project(camera, top).place;
    const Matrix<2> J = f.asDiagonal() * m.J;
    a.shape = J * reduced * J.transpose();
    a.shape(1, 0) = a.shape(0, 1);
    a.area = M_PI * std::sqrt(a.shape.determinant());
    Vector<2> centroid = m.place;
    if (Vector<5>(camera.k1, camera.k2, camera.p1, camera.p2, camera.k3).any())
        centroid += distorted_centroid(camera, middle, reduced, m.place);
    a.centroid = centroid.cwiseProduct(f) + offset;
    return a;
}

Vector<2> seen_at(const BallView& view, const Vector<3>& direction) {
    return project(view.camera, view.rotation.transpose() * (view.centre - view.position + view.radius * direction))
        .place;
}

void bind_appearance(nb::module_& m) {
    m.def("appearance", &appearance_, arg("directions"), arg("view"));
    m.def("seen_at", &seen_at_, arg("directions"), arg("view"));
}

}  // namespace spheremouse::ball
