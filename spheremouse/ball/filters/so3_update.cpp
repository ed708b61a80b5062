// Correction of the default filter. `so3_motion.py` gives the order of the errors.
#include "spheremouse/ball/filters/so3.h"

namespace spheremouse::ball {
namespace {

constexpr int PAIRS_WITHOUT_MODES = 2;  // four equations for a rotation: a step and a half-hidden disc look alike

/// Return true if the rate is five standard deviations from zero. Noise must not determine a readout.
bool is_significant(const Body& body) {
    const Matrix<3> C = body.P.block<3, 3>(3, 3);
    const int at = body.readout_row();
    return body.P(at, at) > 0.0 && body.rate.dot(C.ldlt().solve(body.rate)) > 25.0;
}

/// Subtract A' B from C, (n, p), where A is (m, n) and B (m, p). If `lower`, only from the lower triangle of C.
WIDE void subtract_product(const double* A, const double* B, int m, int n, int p, bool lower, double* C) {
    for (int i = 0; i < n; i++) {
        const int end = lower ? i + 1 : p;
        double* row = C + size_t(i) * p;
        int r = 0;
        for (; r + 4 <= m; r += 4) {
            const double *a = A + size_t(r) * n + i, *b = B + size_t(r) * p;
            const double f0 = a[0], f1 = a[n], f2 = a[2 * n], f3 = a[3 * n];
            for (int j = 0; j < end; j++) row[j] -= f0 * b[j] + f1 * b[p + j] + f2 * b[2 * p + j] + f3 * b[3 * p + j];
        }
        for (; r < m; r++) {
            const double f = A[size_t(r) * n + i], *b = B + size_t(r) * p;
            for (int j = 0; j < end; j++) row[j] -= f * b[j];
        }
    }
}

void subtract_product(const Dense& A, const Dense& B, Dense& C, bool lower = false) {
    subtract_product(A.data(), B.data(), int(A.rows()), int(A.cols()), int(B.cols()), lower, C.data());
}

/// Correct the errors by the innovations, with a step of the acceleration of unknown instant and level.
///
/// Rate and acceleration are a mixture of modes. The other errors are a regression on them, and its residuals have one
/// covariance for all modes. The new covariance is that of the whole mixture.
///
/// The axes keep their estimate and covariance (Schmidt 1966). So does a rig that is known well, and the readout time
/// while the rate is not significant, and all errors of the other cameras. They are independent of the modes, so
/// rate and acceleration are taken given them. Each hypothesis is then an ordinary update of Schmidt's filter, and
/// their sum has a positive covariance. The reference keeps its estimate, since its increment was sent. Its covariance
/// is the second moment about that estimate.
Corrected correct(const Body& body, const Innovation& seen, const Pending& pending, const Activity& activity) {
    const View<>& prior = body.P;
    const int n = int(prior.rows()), k2 = int(seen.z.size()), m = 6 + k2;
    const int apart = (is_significant(body) ? body.readout_row() : body.map_row()) - CORE;
    const int first = body.holds ? RIG : AXES, held = apart - (first - CORE);
    Dense U = prior.middleRows(CORE, apart), HU = seen.HP.middleCols(CORE, apart).transpose();
    const Dense Lc = lower<Dynamic>(prior.block(CORE, CORE, apart, apart));
    solve_lower(Lc, U);
    solve_lower(Lc, HU);
    const Dense by_apart = U.middleCols<6>(3);
    const Matrix<6> shared = by_apart.transpose() * by_apart;
    Dense V = prior.middleRows<6>(3), N = seen.HP.middleCols<6>(3).transpose(), S = seen.S;
    subtract_product(by_apart, U, V);
    subtract_product(by_apart, HU, N);
    V.middleCols(CORE, apart).setZero();
    Effect effect;
    effect.root = lower<6>(V.middleCols<6>(3));
    solve_lower(effect.root, V);
    solve_lower(effect.root, N);
    subtract_product(N, N, S);
    const Eigen::LLT<Dense> L(S);
    if (L.info() != Eigen::Success) throw std::domain_error("covariance of the innovations is not positive definite");
    Dense G(k2, 16);  // of x, d and z
    G << N.transpose(), seen.H, seen.z;
    L.matrixL().solveInPlace(G);
    Dense rest = seen.HP;
    subtract_product(N, V, rest);
    L.matrixL().solveInPlace(rest);
    Dense W(m, n);  // rate and acceleration, whitened, and then the innovations, in all errors
    W << V, rest;

    // The errors after the correction are rest' white + T e for the errors e = (x, d), and T = W' B but for the core.
    Matrix<Dynamic, 15> B(m, 15);
    B.topRows<6>() = Matrix<6, 15>::Identity();
    B.bottomRows(k2) = -G.leftCols<15>();
    effect.T = W.middleCols<6>(3).transpose() * B;
    effect.T.rightCols<6>() += Matrix<6>::Identity();
    effect.shared = shared - rest.middleCols<6>(3).transpose() * rest.middleCols<6>(3);
    Modes modes = pending.modes;
    for (Matrix<6>& C : modes.covariances) C -= shared;
    const Steps steps{pending.interval, activity.persistence, activity.variances, activity.usual};
    Vector<6> motion;
    motion << body.rate, body.acceleration;
    Corrected r;
    Dense gram = Dense::Zero(16, 16);
    subtract_product(G, G, gram);
    r.steps = posterior(-gram, effect, motion, steps, modes);
    const Vector<Dynamic> white = G.col(15);
    Vector<Dynamic> by(m);
    by << r.steps.mean.head<6>(), white - G.leftCols<15>() * r.steps.mean;
    r.dx = W.transpose() * by;
    r.dx.head<CORE>() += r.steps.mean.tail<CORE>();
    r.dx.segment(first, held).setZero();

    // P - W' W + T C T'
    const Matrix<Dynamic, 15> BC = B * r.steps.covariance;
    const Dense X = BC * B.transpose(), step = -BC.rightCols<CORE>();
    Dense reduced = W, cross = Dense::Zero(n, CORE), with_held = prior.middleCols(first, held);
    subtract_product(X, W, reduced);
    subtract_product(W, step, cross);
    r.P = prior;
    subtract_product(W, reduced, r.P, true);
    r.P.leftCols<CORE>() += cross;
    r.P.topLeftCorner<CORE, CORE>() +=
        cross.topRows<CORE>().transpose() + r.steps.covariance.bottomRightCorner<CORE, CORE>();
    const Matrix<15, Dynamic> inner = r.steps.within * (G.leftCols<15>().transpose() * rest.middleCols(first, held));
    Dense of_held = B * inner;
    of_held.bottomRows(k2) += rest.middleCols(first, held);
    subtract_product(W, of_held, with_held);
    with_held.topRows<CORE>() -= inner.bottomRows<CORE>();
    with_held.middleRows(first, held) = prior.block(first, first, held, held);
    r.P.middleCols(first, held) = with_held;
    r.P.middleRows(first, held) = with_held.transpose();
    r.P.bottomRightCorner<CLONE, CLONE>() += r.dx.tail<CLONE>() * r.dx.tail<CLONE>().transpose();
    r.dx.tail<CLONE>().setZero();
    r.P.triangularView<Eigen::StrictlyUpper>() = r.P.transpose();
    const double square = white.squaredNorm();
    r.nis = r.steps.excess + square;
    r.pairs = k2 / 2;
    r.log_likelihood =
        r.steps.log_ratio - 0.5 * (square + k2 * std::log(2.0 * M_PI)) - L.matrixLLT().diagonal().array().log().sum();
    return r;
}

/// What a correction uses besides the prior of the errors.
struct Evidence {
    const Body& predicted;
    const Points& points;
    const Pairs& pairs;
    const Pending& pending;
    const Activity& activity;
};

/// Correct a state by innovations that are linear about `about`, where the prior of the errors has a mean.
///
/// A large correction is made again about the state that it leads to: the iterated Kalman filter (Bell and Cathey
/// 1993). The log likelihood is then Laplace's approximation.
std::pair<Corrected, Moved> correct_about(const Evidence& by, const Body& about, const Each& mean,
                                          const Innovation& seen, int round = 0) {
    const Body prior{about.attitude, by.predicted.rate, by.predicted.acceleration,
                     about.discs,    about.basis,       about.P,
                     about.readout,  about.rig,         about.eccentricity,
                     about.known,    about.holds,       about.others};
    Corrected r = correct(prior, seen, by.pending, by.activity);
    r.dx += mean;
    if (round == 3 || r.dx.head<3>().cwiseAbs().maxCoeff() < (round == 0 ? LINEAR : 0.1 * LINEAR)) {
        Moved moved = move(about, r.dx, std::move(r.P));
        return {std::move(r), std::move(moved)};
    }
    r.dx(about.readout_row()) = 0.0;
    r.dx.segment<3 + RIG_DIM>(ECCENTRICITY).setZero();  // the innovation is linear in readout, eccentricity and rig
    Each there = mean - r.dx;
    const Moved at = move(about, r.dx, about.P, &there);
    Innovation again = innovation(at.body(), by.points, by.pairs, Noise::Zero());
    again.z -= again.H * there.head<CORE>();
    for (size_t i = 0; i < by.pairs.columns.size(); i++)
        again.z.segment<2>(2 * nb::ssize_t(i)) -= there.segment<2>(about.map_row() + 2 * by.pairs.columns[i]);
    try {
        return correct_about(by, at.body(), there, again, round + 1);
    } catch (const std::domain_error&) {  // pairs that contradict each other lead to no state
        Moved moved = move(about, r.dx, std::move(r.P));
        return {std::move(r), std::move(moved)};
    }
}

}  // namespace

std::pair<Corrected, Moved> correct_by_pairs(const Body& body, const Points& points, const Pairs& pairs,
                                             const Pending& pending, const Activity& activity) {
    return correct_about({body, points, pairs, pending, activity}, body, Each::Zero(body.P.rows()), pairs.innovation);
}

Activity read_activity(nb::tuple activity) {
    members(activity, 6, "activity");
    const auto scalar = [&](int i) { return number<double>(activity[i], "activity"); };
    Activity r{scalar(0),
               scalar(1),
               scalar(2),
               vector(activity[3], "variances"),
               vector(activity[4], "drift"),
               vector(activity[5], "usual")};
    if (r.variances.size() == 0 || r.drift.size() != r.variances.size() || r.usual.size() != r.variances.size())
        throw nb::type_error("variances, drift, usual: must have one element for each level");
    return r;
}

Pending read_pending(nb::tuple pending, const Body& body, const Activity& activity) {
    members(pending, 4, "pending");
    Pending r{matrix<CORE, CORE>(pending[0], "process"),
              number<double>(pending[1], "pending"),
              vector(pending[2], "weights"),
              {}};
    if (r.weights.size() == 0) r.weights = activity.usual;
    if (!pending[3].is_none())
        r.modes = read_modes(members(pending[3], 3, "modes"));
    else
        r.modes = {{Vector<6>::Zero()}, {body.P.block<6, 6>(3, 3)}, r.weights.transpose()};
    if (r.weights.size() != activity.usual.size() || r.modes.weights.cols() != activity.usual.size())
        throw nb::type_error("weights: must have one element for each level");
    return r;
}

nb::tuple corrected_to_numpy(const Moved& moved, const Corrected& r) {
    const Matrix<Dynamic> at_level = r.steps.modes.weights.colwise().sum();
    const bool certain = r.pairs == 0 || r.pairs > PAIRS_WITHOUT_MODES;
    const nb::object modes = certain ? nb::object(modes_to_numpy(r.steps.modes)) : nb::none();
    return nb::make_tuple(moved_to_numpy(moved), to_numpy(moved.P), to_numpy(Each(at_level.row(0))),
                          nb::make_tuple(r.steps.level, r.nis, moved.readout, to_numpy(moved.rig), to_numpy(moved.eccentricity)),
                          modes);
}

namespace {

nb::tuple correct_(nb::tuple body_, nb::tuple points_, nb::tuple pairs_, nb::tuple pending_, nb::tuple activity_) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body);
    members(pairs_, 3, "pairs");
    Pairs pairs = read_pairs(pairs_[0], pairs_[1], body, points);
    const Noise added = matrix<CORE, CORE>(pairs_[2], "added");
    const Activity activity = read_activity(activity_);
    const Pending pending = read_pending(pending_, body, activity);
    Corrected r;
    Moved moved;
    {
        nb::gil_scoped_release release;
        pairs.innovation = innovation(body, points, pairs, added);
        std::tie(r, moved) = correct_by_pairs(body, points, pairs, pending, activity);
    }
    return nb::make_tuple(corrected_to_numpy(moved, r), r.log_likelihood);
}

NewArray<double> since_reference(nb::handle P_, nb::handle turn_) {
    const auto P = matrix(P_, "P");
    const Vector<3> turn = vector<3>(turn_, "turn");
    if (P.rows() != P.cols() || P.rows() < MAP_OFFSET + CLONE)
        throw nb::type_error("P: must be square, with 23 rows or more");
    const Matrix<3> J = left_jacobian(turn).inverse();
    Matrix<6, 9> A = Matrix<6, 9>::Zero();  // of rotation, rate and reference in turn and rate
    A.topLeftCorner<3, 3>() = J;
    A.topRightCorner<3, 3>() = -J * exp(turn);
    A.block<3, 3>(3, 3).setIdentity();
    Matrix<9> C;
    C << P.topLeftCorner<6, 6>(), P.topRightCorner<6, 3>(), P.bottomLeftCorner<3, 6>(), P.bottomRightCorner<3, 3>();
    return to_numpy(Matrix<6>(A * C * A.transpose()));
}

}  // namespace

void bind_so3_update(nb::module_& m) {
    m.def("since_reference", &since_reference, arg("P"), arg("turn"));
    m.def("correct", &correct_, arg("body"), arg("points"), arg("pairs"), arg("pending"), arg("activity"));
}

}  // namespace spheremouse::ball
