// Points that the state takes up as landmarks, with covariance and correlations.
//
// A landmark is at R' b, where b is the direction of its point. That is the inverse observation of EKF-SLAM, which
// Wittich 2017, eq. 171 leaves out. An error of its place is that of the innovation of the point, with the other sign.
#include "spheremouse/ball/filters/so3.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr double MAX_PLACE_VARIANCE = 0.25;  // rad²: a disc that may be anywhere is no worse

struct Found {
    Rows<3> places;    // ball
    Rows<3, 2> basis;  // ball
    Dense joint;       // with the errors of the new landmarks after those of the others
};

/// Return points as landmarks. Unless the centre moves, the squared rig variance stands for the terms that J omits.
Found take_up(const Body& body, const Points& points, const Indices& which, bool centre_moves) {
    const int k = int(which.size()), old = int(body.P.rows()), n = old - CLONE;
    Found r{Rows<3>(which.size()), Rows<3, 2>(which.size()), Dense(old + 2 * k, old + 2 * k)};
    Matrix<Dynamic, FIXED> G(2 * k, FIXED);
    Dense noise = Dense::Zero(2 * k, 2 * k);
    for (int i = 0; i < k; i++) {
        const int point = which[size_t(i)];
        const Matrix<3> R = exp(body.turn(points.delay(point))) * body.attitude;
        r.places[size_t(i)] = R.transpose() * points.direction.row(point).transpose();
        r.basis[size_t(i)] = tangent_basis(r.places[size_t(i)]);
        const Place place(r.places[size_t(i)], r.basis[size_t(i)], R);
        auto J = G.middleRows<2>(2 * i);
        J = -jacobian(body, points, point, place);
        noise.block<2, 2>(2 * i, 2 * i) = place.E.transpose() * points.noise(point) * place.E;
        if (centre_moves) continue;
        const auto by_rig = J.middleCols<RIG_DIM>(RIG);
        const double rig_variance = (by_rig * body.P.block<RIG_DIM, RIG_DIM>(RIG, RIG) * by_rig.transpose()).trace();
        noise.diagonal().segment<2>(2 * i).array() += std::pow(std::min(rig_variance, MAX_PLACE_VARIANCE), 2);
    }
    Dense fixed(FIXED, old);  // the rows of P in the order of G
    fixed << body.P.topRows<READOUT>(), body.P.row(body.readout_row());
    const Dense GP = G * fixed;
    r.joint.topLeftCorner(n, n) = body.P.topLeftCorner(n, n);
    r.joint.block(n, 0, 2 * k, n) = GP.leftCols(n);
    r.joint.block(n, n, 2 * k, 2 * k) = fixed_columns(GP, body) * G.transpose() + noise;
    r.joint.bottomRows<CLONE>() << body.P.bottomLeftCorner(CLONE, n), GP.rightCols<CLONE>().transpose(),
        body.P.bottomRightCorner<CLONE, CLONE>();
    r.joint.triangularView<Eigen::StrictlyUpper>() = r.joint.transpose();
    return r;
}

nb::tuple take_up_(nb::tuple body_, nb::tuple points_, nb::handle which_, bool centre_moves) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body);
    const Found r = take_up(body, points, read_indices(which_, "which", points.size()), centre_moves);
    return nb::make_tuple(r.places.array, r.basis.array, to_numpy(r.joint));
}

}  // namespace

void bind_so3_map(nb::module_& m) {
    m.attr("MAX_PLACE_VARIANCE") = MAX_PLACE_VARIANCE;
    m.def("take_up", &take_up_, arg("body"), arg("points"), arg("which"), arg("centre_moves"));
}

}  // namespace spheremouse::ball
