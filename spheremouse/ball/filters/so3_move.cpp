// Moves of the default filter's state by errors, and the covariance of the errors about the moved state.
//
// A disc that was founded at a doubtful attitude shares the error of that attitude. No image shows this error, a turn
// of the ball in one direction and of its discs in the other. If the errors stayed as they are when a correction moves
// the state, each large correction would seem to measure the shared error (Huang, Mourikis and Roumeliotis 2010,
// "Observability-based rules for designing consistent EKF SLAM estimators"; Barrau and Bonnabel 2015, "An EKF-SLAM
// algorithm with consistency properties").
#include "spheremouse/ball/filters/so3.h"

namespace spheremouse::ball {
namespace {

constexpr double NEGLIGIBLE = 1e-6;  // rad: a change of errors by a hundredth of an image's noise

struct Disc {
    Vector<3> at;
    Matrix<3, 2> axes;

    Disc moved(const Vector<2>& by) const {
        const Vector<3> to = (at + axes * by).normalized();
        const Vector<3> first = (axes.col(0) - to.dot(axes.col(0)) * to).normalized(), second = to.cross(first);
        Disc r{to, Matrix<3, 2>()};
        r.axes << first, second.dot(axes.col(1)) > 0.0 ? second : Vector<3>(-second);
        return r;
    }

    /// The effect of a small turn of the ball in obj on the disc's place.
    Matrix<2, 3> by_turn(const Matrix<3>& attitude) const {
        return -(attitude * axes).transpose() * hat(attitude * at);
    }
};

Disc disc(const Body& body, int k) { return {body.discs.row(k), View<3, 2>(body.basis.row(k).data())}; }

bool is_negligible(const Body& body, const Dense& P, const Each& dx) {
    const double turn = dx.head<3>().cwiseAbs().maxCoeff(),
                 most = std::max(turn, dx.tail(dx.size() - body.map_row()).cwiseAbs().maxCoeff());
    return most * most * P.diagonal().head<3>().maxCoeff() < NEGLIGIBLE * NEGLIGIBLE;
}

/// Return the matrix, (n, n), from the errors of a state to those of the state moved by `dx`.
///
/// A regression on the errors of the discs determines the shared error. The move consists of such a turn, after which
/// each of these discs has the same place in obj, and of a turn of the whole ball. The shared error turns with both. So
/// it keeps its components in the axes of the ball, in which a turn that no image shows is the same for all states.
Dense transfer(const Body& body, const Dense& P, const Each& dx) {
    const int m = body.size(), map = body.map_row();
    const Dense with = P.block(0, map, 3, 2 * m);
    Dense G(3, 2 * m);  // the shared error by those of the discs
    if (m > 0) G = Dense(P.block(map, map, 2 * m, 2 * m)).ldlt().solve(with.transpose()).transpose();
    const Vector<3> shared = G * dx.segment(map, 2 * m);
    const Vector<3> of_ball = log(exp(dx.head<3>()) * exp(-shared));
    const Matrix<3> J = left_jacobian(shared), K = left_jacobian(of_ball), S = exp(shared), turned = S * body.attitude,
                    variance = with * G.transpose();
    Dense T = Dense::Identity(dx.size(), dx.size());
    T.topLeftCorner<3, 3>() = K * J;
    T.block(0, map, 3, 2 * m) = (exp(of_ball) * S - K * J) * G;
    for (int k = 0; k < m; k++) {
        const Disc before = disc(body, k), after = before.moved(dx.segment<2>(map + 2 * k));
        const Matrix<2, 3> A = before.by_turn(body.attitude);
        const double own = -(A * with.middleCols<2>(2 * k)).trace(), whole = (A * variance * A.transpose()).trace();
        if (!(own > 0.0 && whole > 0.0)) continue;
        T.block(map + 2 * k, map, 2, 2 * m) += std::min(own / whole, 1.0) * (A - after.by_turn(turned) * S) * G;
    }
    return T;
}

}  // namespace

Moved move(const Body& body, const Each& dx, Dense P, Each* error) {
    Moved r{exp(dx.head<3>()) * body.attitude,
            body.rate + dx.segment<3>(3),
            body.acceleration + dx.segment<3>(6),
            Matrix<Dynamic, 3>(body.size(), 3),
            Matrix<Dynamic, 6>(body.size(), 6),
            std::move(P),
            body.readout + dx(body.readout_row()),
            body.rig + dx.segment<RIG_DIM>(RIG),
            body.eccentricity + dx.segment<3>(ECCENTRICITY),
            body.known,
            body.holds,
            body.others};
    for (int k = 0; k < body.size(); k++) {
        const Disc moved = disc(body, k).moved(dx.segment<2>(body.map_row() + 2 * k));
        r.discs.row(k) = moved.at;
        Eigen::Map<Matrix<3, 2>>(r.basis.row(k).data()) = moved.axes;
    }
    if (!is_negligible(body, r.P, dx)) {
        const Dense T = transfer(body, r.P, dx), moved = T * r.P * T.transpose();
        r.P = 0.5 * (moved + moved.transpose());
        if (error) *error = T * *error;
    }
    return r;
}

Body Moved::body() const {
    return {attitude,
            rate,
            acceleration,
            View<Dynamic, 3>(discs.data(), discs.rows(), 3),
            View<Dynamic, 6>(basis.data(), basis.rows(), 6),
            View<>(P.data(), P.rows(), P.cols()),
            readout,
            rig,
            eccentricity,
            known,
            holds,
            others};
}

nb::tuple moved_to_numpy(const Moved& r) {
    const size_t m = size_t(r.discs.rows());
    auto basis = zeros<double>({m, 3, 2});
    std::copy_n(r.basis.data(), 6 * m, basis.data());
    return nb::make_tuple(to_numpy(r.attitude), to_numpy(r.rate), to_numpy(r.acceleration), to_numpy(r.discs), basis);
}

namespace {

nb::tuple move_(nb::tuple body_, nb::handle dx_) {
    const Body body = read_body(body_);
    const auto dx = vector(dx_, "dx");
    if (dx.size() != body.P.rows()) throw nb::type_error("dx: must have the rows of joint");
    const Moved moved = move(body, dx, body.P);
    return nb::make_tuple(moved_to_numpy(moved), to_numpy(moved.P), moved.readout, to_numpy(moved.rig),
                          to_numpy(moved.eccentricity));
}

}  // namespace

void bind_so3_move(nb::module_& m) { m.def("move", &move_, arg("body"), arg("dx")); }

}  // namespace spheremouse::ball
