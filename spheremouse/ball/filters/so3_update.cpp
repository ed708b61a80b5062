// Correction of the default filter. `so3_motion.py` gives the order of the errors.
#include "spheremouse/ball/filters/so3_steps.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

using Dense = Matrix<Dynamic>;

/// The innovations of k pairs: H, (2k, 9), H P, (2k, n), z, (2k,), and the covariance S of z.
struct Innovation {
    View<Dynamic, CORE> H;
    View<> HP;
    Eigen::Map<const Vector<Dynamic>> z;
    View<> S;
};

struct Corrected {
    Dense P;
    Vector<Dynamic> dx;
    Posterior steps;
    double log_likelihood, nis;
};

/// Return true if the rate is five standard deviations from zero. Noise must not determine a readout.
bool is_significant(const Vector<3>& rate, const View<>& P) {
    const Matrix<3> C = P.block<3, 3>(3, 3);
    return P(READOUT, READOUT) > 0.0 && rate.dot(C.ldlt().solve(rate)) > 25.0;
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
/// Considered parameters keep their estimate and covariance (Schmidt 1966), and so does the readout time while the rate
/// is not significant. They are independent of the modes, so rate and acceleration are taken given these parameters.
/// Each hypothesis is then an ordinary update of Schmidt's filter, and their sum has a positive covariance. The
/// reference keeps its estimate, since its increment was sent. Its covariance is the second moment about that estimate.
Corrected correct(const View<>& prior, const Innovation& seen, const Vector<3>& rate, const Vector<3>& acceleration,
                  const Steps& steps, Modes& modes) {
    const int n = int(prior.rows()), k2 = int(seen.z.size()), m = 6 + k2;
    const int held = (is_significant(rate, prior) ? READOUT : MAP_OFFSET) - CORE;
    Dense U = prior.middleRows(CORE, held), HU = seen.HP.middleCols(CORE, held).transpose();
    const Dense Lc = lower<Dynamic>(prior.block(CORE, CORE, held, held));
    solve_lower(Lc, U);
    solve_lower(Lc, HU);
    const Dense by_held = U.middleCols<6>(3);
    const Matrix<6> shared = by_held.transpose() * by_held;
    Dense V = prior.middleRows<6>(3), N = seen.HP.middleCols<6>(3).transpose(), S = seen.S;
    subtract_product(by_held, U, V);
    subtract_product(by_held, HU, N);
    V.middleCols(CORE, held).setZero();
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
    for (Matrix<6>& C : modes.covariances) C -= shared;
    Corrected r;
    r.steps = posterior(G.transpose() * G, effect, acceleration, steps, modes);
    const Vector<Dynamic> white = G.col(15);
    Vector<Dynamic> by(m);
    by << r.steps.mean.head<6>(), white - G.leftCols<15>() * r.steps.mean;
    r.dx = W.transpose() * by;
    r.dx.head<CORE>() += r.steps.mean.tail<CORE>();
    r.dx.segment(CORE, held).setZero();

    // P - W' W + T C T'
    const Matrix<Dynamic, 15> BC = B * r.steps.covariance;
    const Dense X = BC * B.transpose(), step = -BC.rightCols<CORE>();
    Dense reduced = W, cross = Dense::Zero(n, CORE), with_held = prior.middleCols(CORE, held);
    subtract_product(X, W, reduced);
    subtract_product(W, step, cross);
    r.P = prior;
    subtract_product(W, reduced, r.P, true);
    r.P.leftCols<CORE>() += cross;
    r.P.topLeftCorner<CORE, CORE>() +=
        cross.topRows<CORE>().transpose() + r.steps.covariance.bottomRightCorner<CORE, CORE>();
    const Matrix<15, Dynamic> inner = r.steps.within * (G.leftCols<15>().transpose() * rest.middleCols(CORE, held));
    Dense of_held = B * inner;
    of_held.bottomRows(k2) += rest.middleCols(CORE, held);
    subtract_product(W, of_held, with_held);
    with_held.topRows<CORE>() -= inner.bottomRows<CORE>();
    with_held.middleRows(CORE, held) = prior.block(CORE, CORE, held, held);
    r.P.middleCols(CORE, held) = with_held;
    r.P.middleRows(CORE, held) = with_held.transpose();
    r.P.bottomRightCorner<CLONE, CLONE>() += r.dx.tail<CLONE>() * r.dx.tail<CLONE>().transpose();
    r.dx.tail<CLONE>().setZero();
    r.P.triangularView<Eigen::StrictlyUpper>() = r.P.transpose();
    const double square = white.squaredNorm();
    r.nis = r.steps.excess + square;
    r.log_likelihood =
        r.steps.log_ratio - 0.5 * (square + k2 * std::log(2.0 * M_PI)) - L.matrixLLT().diagonal().array().log().sum();
    return r;
}

nb::tuple correct_(nb::handle prior_, nb::tuple innovation, nb::handle rate_, nb::handle acceleration_,
                   nb::tuple steps_, nb::tuple modes_) {
    const auto prior = matrix(prior_, "prior");
    const Innovation seen{matrix<Dynamic, CORE>(innovation[0], "H"), matrix(innovation[1], "HP"),
                          vector(innovation[2], "z"), matrix(innovation[3], "S")};
    const nb::ssize_t n = prior.rows(), k2 = seen.z.size();
    if (prior.cols() != n || n < MAP_OFFSET + CLONE)
        throw nb::type_error("prior: must be square, with 23 rows or more");
    if (seen.H.rows() != k2 || seen.HP.rows() != k2 || seen.HP.cols() != n)
        throw nb::type_error("H, HP: must have the rows of z, and HP the columns of prior");
    if (seen.S.rows() != k2 || seen.S.cols() != k2) throw nb::type_error("S: must have the rows and columns of z");
    const Steps steps{nb::cast<double>(steps_[0]), nb::cast<double>(steps_[1]), vector(steps_[2], "variances")};
    Modes modes = read_modes(modes_);
    if (modes.weights.cols() != steps.variances.size() || modes.weights.cols() == 0)
        throw nb::type_error("weights: must have a column for each level");
    const Vector<3> rate = vector<3>(rate_, "rate"), acceleration = vector<3>(acceleration_, "acceleration");
    Corrected r;
    {
        nb::gil_scoped_release release;
        r = correct(prior, seen, rate, acceleration, steps, modes);
    }
    const Vector<Dynamic> at_level = r.steps.modes.weights.colwise().sum().transpose();
    return nb::make_tuple(to_numpy(r.P), modes_to_numpy(r.steps.modes), to_numpy(at_level), to_numpy(r.dx),
                          r.log_likelihood, r.nis, r.steps.level);
}

nb::ndarray<nb::numpy, double> since_reference(nb::handle P_, nb::handle turn_) {
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

nb::tuple move(nb::handle attitude_, nb::handle discs_, nb::handle basis_, nb::handle dx_) {
    const auto attitude = matrix<3, 3>(attitude_, "attitude");
    const auto discs = matrix<Dynamic, 3>(discs_, "discs");
    const auto basis = array<const double, -1, 3, 2>(basis_, "basis");
    const auto dx = vector(dx_, "dx");
    const size_t m = size_t(discs.rows());
    if (basis.shape(0) != m) throw nb::type_error("basis: must have the length of discs");
    if (size_t(dx.size()) != MAP_OFFSET + 2 * m + CLONE)
        throw nb::type_error("dx: must have 23 elements and two for each disc");
    auto new_discs = zeros<double>({m, 3}), new_basis = zeros<double>({m, 3, 2});
    for (size_t i = 0; i < m; i++) {
        const Matrix<3, 2> E = View<3, 2>(basis.data() + 6 * i);
        const Vector<3> to =
            (discs.row(nb::ssize_t(i)).transpose() + E * dx.segment<2>(MAP_OFFSET + 2 * nb::ssize_t(i))).normalized();
        const Vector<3> first = (E.col(0) - to.dot(E.col(0)) * to).normalized(), second = to.cross(first);
        Eigen::Map<Vector<3>>(new_discs.data() + 3 * i) = to;
        Eigen::Map<Matrix<3, 2>> axes(new_basis.data() + 6 * i);
        axes.col(0) = first;
        axes.col(1) = second.dot(E.col(1)) > 0.0 ? second : Vector<3>(-second);
    }
    return nb::make_tuple(to_numpy(Matrix<3>(exp(dx.head<3>()) * attitude)), new_discs, new_basis);
}

}  // namespace

void bind_so3_update(nb::module_& m) {
    m.def("since_reference", &since_reference, arg("P"), arg("turn"));
    m.def("move", &move, arg("attitude"), arg("discs"), arg("basis"), arg("dx"));
    m.def("correct", &correct_, arg("prior"), arg("innovation"), arg("rate"), arg("acceleration"), arg("steps"),
          arg("modes"));
}

}  // namespace spheremouse::ball
