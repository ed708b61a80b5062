// Intersection of image rays with the ball, as `points.py` describes it.
#include "spheremouse/ball/ball_view.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

using Pixels = Array<const double, -1, 2>;

/// A ray that meets the ball.
struct Seen {
    size_t index;       // of its pixel
    Matrix<2> dxy_duv;  // of its reduced coordinates
    Hit hit;
};

std::vector<Seen> meet(const Pixels& uv, const BallView& view) {
    std::vector<Seen> met;
    for (size_t i = 0; i < uv.shape(0); i++) {
        const Mapped<> reduced = unproject(view.camera, Vector<2>(uv(i, 0), uv(i, 1)));
        const Hit hit = first_hit(view, reduced.place);
        if (hit.met) met.push_back({i, reduced.J, hit});
    }
    return met;
}

/// Return J C J', exactly symmetric.
template <int N>
Matrix<3> propagate(const Matrix<3, N>& J, const Matrix<N>& C) {
    Matrix<3> P = J * C * J.transpose();
    P.triangularView<Eigen::StrictlyUpper>() = P.transpose();
    return P;
}

nb::tuple intersect(nb::handle centre_, nb::handle noise_, nb::handle view_) {
    const auto centre = array<const double, -1, 2>(centre_, "centre");
    const auto noise = array<const double, -1, 2, 2>(noise_, "noise");
    if (noise.shape(0) != centre.shape(0)) throw nb::type_error("noise: must have the length of centre");
    const BallView view = read_ball_view(view_);
    const std::vector<Seen> met = meet(centre, view);
    const size_t n = met.size();
    const Rows<3> position(n), direction(n);
    const Rows<3, 3> covariance(n), image_covariance(n);
    const Rows<3, 4> by_rig(n);
    auto delay = zeros<double>({n}), row = zeros<double>({n});
    auto index = zeros<int64_t>({n});
    // a longer focal length shows the ball in the same place if it is farther away by the same share
    const Vector<3> axis = view.rotation.col(2), receding = axis * axis.dot(view.centre - view.position);
    for (size_t i = 0; i < n; i++) {
        const Hit& hit = met[i].hit;
        const Vector<3> normal = (hit.point - view.centre) / view.radius;
        const Vector<3> along = hit.ray / normal.dot(hit.ray);  // the product is negative on the near side
        const Matrix<3> slide = Matrix<3>::Identity() - along * normal.transpose();
        const Vector<2> focal(centre(met[i].index, 0) - view.camera.cx, centre(met[i].index, 1) - view.camera.cy);
        Matrix<3, 10> J;  // by pose and ball
        J << slide, -hit.scale * slide * hat(hit.ray), along * normal.transpose(), along;
        const Matrix<3, 2> by_image = hit.scale * slide * view.rotation.leftCols<2>() * met[i].dxy_duv;
        position[i] = hit.point;
        direction[i] = normal;
        Matrix<3, 4> by;  // of the point relative to the centre, by focal length and centre
        by.rightCols<3>() = J.middleCols<3>(6) - Matrix<3>::Identity();
        by.col(0) = by.rightCols<3>() * receding - by_image * focal + view.radius * view.focal_turn.cross(normal);
        by_rig[i] = by / view.radius;
        image_covariance[i] = propagate<2>(by_image, View<2, 2>(noise.data() + 4 * met[i].index));
        covariance[i] = image_covariance[i] + propagate<10>(J, view.covariance);
        row.data()[i] = row_of(view.camera, centre(met[i].index, 1));
        delay.data()[i] = view.readout * row.data()[i];
        index.data()[i] = int64_t(met[i].index);
    }
    return nb::make_tuple(position.array, covariance.array, direction.array, image_covariance.array, by_rig.array,
                          delay, row, index);
}

nb::tuple directions_at(nb::handle uv_, nb::handle view_) {
    const BallView view = read_ball_view(view_);
    const std::vector<Seen> met = meet(array<const double, -1, 2>(uv_, "uv"), view);
    const Rows<3> direction(met.size());
    auto index = zeros<int64_t>({met.size()});
    for (size_t i = 0; i < met.size(); i++) {
        direction[i] = (met[i].hit.point - view.centre) / view.radius;
        index.data()[i] = int64_t(met[i].index);
    }
    return nb::make_tuple(direction.array, index);
}

}  // namespace

void bind_points(nb::module_& m) {
    m.def("intersect", &intersect, arg("centre"), arg("noise"), arg("view"));
    m.def("directions_at", &directions_at, arg("uv"), arg("view"));
}

}  // namespace spheremouse::ball
