// The motion of the default filter between two frames, under an acceleration that lasts or fades.
#include "spheremouse/ball/filters/so3_steps.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

struct Motion {
    Vector<3> rate, acceleration;  // rad/s, rad/s²
    double dt, tau;                // s: interval, time constant with which the acceleration fades
};

/// The integrals over t of exp(-t/tau): rate and turn by a unit acceleration that fades.
struct Integrals {
    double first, second;

    Integrals(double t, double tau) {
        if (t < 1e-3 * tau) {  // an acceleration that lasts
            first = t * (1.0 - 0.5 * t / tau);
            second = 0.5 * t * t * (1.0 - t / (3.0 * tau));
        } else {
            first = -tau * std::expm1(-t / tau);
            second = tau * (t - first);
        }
    }
};

Matrix<CORE> transition(const Motion& motion, const Vector<3>& turn) {
    const Integrals whole(motion.dt, motion.tau);
    const Matrix<3> J = left_jacobian(turn);
    Matrix<CORE> F = Matrix<CORE>::Identity();
    F.block<3, 3>(0, 0) = exp(turn);
    F.block<3, 3>(0, 3) = motion.dt * J;
    F.block<3, 3>(0, 6) = whole.second * J;
    F.block<3, 3>(3, 6).diagonal().setConstant(whole.first);
    F.block<3, 3>(6, 6).diagonal().setConstant(std::exp(-motion.dt / motion.tau));
    return F;
}

/// Return the process noise of white jerk of density q, with three nodes of Gauss and Legendre.
///
/// A unit of jerk s before the end leaves an acceleration g_a, a rate g_w, and a turn Jl(turn s/dt) g_t of the ball.
Matrix<CORE> process_noise(const Motion& motion, const Vector<3>& turn, double q) {
    Matrix<CORE> Q = Matrix<CORE>::Zero();
    for (int node = 0; node < 3; node++) {
        const double at = 0.5 + std::sqrt(0.15) * (node - 1), weight = q * motion.dt * (node == 1 ? 8.0 : 5.0) / 18.0;
        const Integrals part(at * motion.dt, motion.tau);
        Matrix<CORE, 3> G;
        G.topRows<3>() = part.second * left_jacobian(at * turn);
        G.middleRows<3>(3) = part.first * Matrix<3>::Identity();
        G.bottomRows<3>() = std::exp(-at * motion.dt / motion.tau) * Matrix<3>::Identity();
        Q += weight * G * G.transpose();
    }
    return Q;
}

nb::tuple predict(nb::handle attitude_, nb::handle rate_, nb::handle acceleration_, nb::handle joint_, double dt,
                  double tau, double q) {
    const auto attitude = matrix<3, 3>(attitude_, "attitude");
    const Motion motion{vector<3>(rate_, "rate"), vector<3>(acceleration_, "acceleration"), dt, tau};
    const auto joint = matrix(joint_, "joint");
    const nb::ssize_t n = joint.rows();
    if (joint.cols() != n || n < CORE) throw nb::type_error("joint: must be square, with 9 rows or more");
    const Vector<3> turn = dt * motion.rate + Integrals(dt, tau).second * motion.acceleration;
    const Matrix<CORE> F = transition(motion, turn), Q = process_noise(motion, turn, q);
    Matrix<Dynamic> P = joint;
    const Matrix<CORE, Dynamic> top = F * joint.topRows<CORE>();
    P.topRows<CORE>() = top;
    P.leftCols<CORE>() = top.transpose();
    const Matrix<CORE> core = top.leftCols<CORE>() * F.transpose() + Q;
    P.topLeftCorner<CORE, CORE>() = 0.5 * (core + core.transpose());
    const Vector<3> rate = motion.rate + F(3, 6) * motion.acceleration, acceleration = F(6, 6) * motion.acceleration;
    return nb::make_tuple(to_numpy(Matrix<3>(F.block<3, 3>(0, 0) * attitude)), to_numpy(rate), to_numpy(acceleration),
                          to_numpy(P), to_numpy(Q), to_numpy(F));
}

nb::tuple predict_modes(nb::tuple modes_, nb::handle F_, nb::handle Q_, nb::handle drift_, double stay,
                        nb::handle usual_) {
    Modes modes = read_modes(modes_);
    const auto F = matrix<CORE, CORE>(F_, "F"), Q = matrix<CORE, CORE>(Q_, "Q");
    const auto drift = vector(drift_, "drift"), usual = vector(usual_, "usual");
    if (modes.weights.cols() != drift.size() || usual.size() != drift.size())
        throw nb::type_error("usual, drift: must have one element for each level");
    const Matrix<6> A = F.block<6, 6>(3, 3), noise = Q.block<6, 6>(3, 3);
    for (size_t j = 0; j < modes.means.size(); j++) {
        const auto w = modes.weights.row(nb::ssize_t(j));
        const double scale = 1.0 + w.dot(drift) / (1e-300 + w.sum());
        modes.means[j] = (A * modes.means[j]).eval();
        modes.covariances[j] = A * modes.covariances[j] * A.transpose() + scale * noise;
    }
    const Vector<Dynamic> of_mode = modes.weights.rowwise().sum();
    modes.weights = stay * modes.weights + (1.0 - stay) * of_mode * usual.transpose();
    return modes_to_numpy(modes);
}

}  // namespace

void bind_so3_motion(nb::module_& m) {
    m.def("predict", &predict, arg("attitude"), arg("rate"), arg("acceleration"), arg("joint"), arg("dt"), arg("tau"),
          arg("q"));
    m.def("predict_modes", &predict_modes, arg("modes"), arg("F"), arg("Q"), arg("drift"), arg("stay"), arg("usual"));
}

}  // namespace spheremouse::ball
