// The motion of the default filter between two frames, under an acceleration that lasts or fades.
#include "spheremouse/ball/filters/so3.h"

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

struct Predicted {
    Matrix<3> attitude;
    Vector<3> rate, acceleration;
    Dense P;
    Noise Q, F;  // process noise in P, transition
};

Predicted predict(const Matrix<3>& attitude, const Motion& motion, const View<>& joint, double q) {
    const Vector<3> turn = motion.dt * motion.rate + Integrals(motion.dt, motion.tau).second * motion.acceleration;
    const Matrix<CORE> F = transition(motion, turn), Q = process_noise(motion, turn, q);
    Dense P = joint;
    const Matrix<CORE, Dynamic> top = F * joint.topRows<CORE>();
    P.topRows<CORE>() = top;
    P.leftCols<CORE>() = top.transpose();
    const Matrix<CORE> core = top.leftCols<CORE>() * F.transpose() + Q;
    P.topLeftCorner<CORE, CORE>() = 0.5 * (core + core.transpose());
    return {F.block<3, 3>(0, 0) * attitude,
            motion.rate + F(3, 6) * motion.acceleration,
            F(6, 6) * motion.acceleration,
            std::move(P),
            Q,
            F};
}

/// Predict the modes. At level k the process noise is 1 + drift(k) times as large. A level stays with a probability.
void predict_modes(Modes& modes, const Predicted& by, double stay, const Activity& activity) {
    const Matrix<6> A = by.F.block<6, 6>(3, 3), noise = by.Q.block<6, 6>(3, 3);
    for (size_t j = 0; j < modes.means.size(); j++) {
        const auto w = modes.weights.row(nb::ssize_t(j));
        const double scale = 1.0 + w.dot(activity.drift) / (1e-300 + w.sum());
        modes.means[j] = (A * modes.means[j]).eval();
        modes.covariances[j] = A * modes.covariances[j] * A.transpose() + scale * noise;
    }
    const Each of_mode = modes.weights.rowwise().sum();
    modes.weights = stay * modes.weights + (1.0 - stay) * of_mode * activity.usual.transpose();
}

/// Predict the state by dt, s, with an acceleration that drifts but makes no step. Q becomes that of the first level.
///
/// If dt exceeds half the mean time between two steps, this applies only to the last part. Before that part the
/// acceleration fades (Singer 1970), which is the mean effect of the steps.
Predicted predict(const Body& body, Pending& pending, double dt, const Activity& activity) {
    const double density = 2.0 * activity.variances(0) / activity.persistence;
    const double noise_scale = 1.0 + pending.weights.dot(activity.drift), stay = std::exp(-dt / activity.dwell);
    const double infinite = std::numeric_limits<double>::infinity();
    pending.interval = std::min(dt, 0.5 * activity.persistence);
    Motion motion{body.rate, body.acceleration, pending.interval, infinite};
    Predicted first{body.attitude, {}, {}, {}, {}, {}};
    if (dt > pending.interval) {
        const Motion fading{body.rate, body.acceleration, dt - pending.interval, activity.persistence};
        first = predict(body.attitude, fading, body.P, density * pending.weights.dot(activity.squares()));
        motion.rate = first.rate;
        motion.acceleration = first.acceleration;
    }
    const View<> P(first.P.size() ? first.P.data() : body.P.data(), body.P.rows(), body.P.cols());
    Predicted r = predict(first.attitude, motion, P, noise_scale * density);
    r.Q /= noise_scale;
    predict_modes(pending.modes, r, stay, activity);
    pending.weights = stay * pending.weights + (1.0 - stay) * activity.usual;
    return r;
}

nb::tuple predict_motion(nb::handle attitude, nb::handle rate, nb::handle acceleration, nb::handle joint_, double dt,
                         double tau, double q) {
    const Motion motion{vector<3>(rate, "rate"), vector<3>(acceleration, "acceleration"), dt, tau};
    const auto joint = matrix(joint_, "joint");
    if (joint.cols() != joint.rows() || joint.rows() < CORE)
        throw nb::type_error("joint: must be square, with 9 rows or more");
    const Predicted r = predict(matrix<3, 3>(attitude, "attitude"), motion, joint, q);
    return nb::make_tuple(to_numpy(r.attitude), to_numpy(r.rate), to_numpy(r.acceleration), to_numpy(r.P));
}

nb::tuple predict_(nb::tuple body_, nb::tuple pending_, double dt, nb::tuple activity_) {
    const Body body = read_body(body_);
    const Activity activity = read_activity(activity_);
    Pending pending = read_pending(pending_, body, activity);
    Predicted r;
    {
        nb::gil_scoped_release release;
        r = predict(body, pending, dt, activity);
    }
    const bool has_modes = dt == pending.interval && !pending_[3].is_none();
    return nb::make_tuple(to_numpy(r.attitude), to_numpy(r.rate), to_numpy(r.acceleration), to_numpy(r.P),
                          to_numpy(pending.weights), to_numpy(r.Q), pending.interval,
                          has_modes ? nb::object(modes_to_numpy(pending.modes)) : nb::none());
}

}  // namespace

void bind_so3_motion(nb::module_& m) {
    m.def("predict_motion", &predict_motion, arg("attitude"), arg("rate"), arg("acceleration"), arg("joint"), arg("dt"),
          arg("tau"), arg("q"));
    m.def("predict", &predict_, arg("body"), arg("pending"), arg("dt"), arg("activity"));
}

}  // namespace spheremouse::ball
