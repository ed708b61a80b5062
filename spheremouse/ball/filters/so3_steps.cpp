#include "spheremouse/ball/filters/so3_steps.h"

#include <array>
#include <limits>

namespace spheremouse::ball {
namespace {

constexpr double NEGLIGIBLE = 1e-5;      // probability of a mode, or of a step as long as it is recent
constexpr double RESOLVED = 1.0 / 30.0;  // s: a step of 1 rad/s² has moved a disc by twice the noise of its place
constexpr double NEIGHBOUR = 1.0 / 3.0;  // of the steps tend to the level below, the same to the one above
constexpr int KINDS = 3;        // of a step: the hand changes its push, lets go, or stops the ball; each as likely
constexpr double MINOR = 1e-3;  // share of a mode below which a hypothesis is left out
constexpr double INFINITE = std::numeric_limits<double>::infinity();

/// One instant of a step: the information c, B on its size, and its levels' probabilities.
struct Instant {
    Vector<3> g;                       // effect of a unit step on rotation, rate and acceleration
    Matrix<3> B;                       // information on the size of the step
    Vector<3> c;                       // B^-1 c is its estimate without a prior
    Matrix<Dynamic, KINDS> p, square;  // (levels, kinds) probability, normalised square of z less z' R^-1 z
};

/// The posterior given one mode of the last frame.
struct Given {
    size_t mode;      // its index
    Vector<6> x;      // mean without a step
    Matrix<6> C;      // covariance of x for a known step
    Matrix<6, 9> Cd;  // a step d moves the mean of x by -Cd d
    Matrix<9> A;      // information on d
    Vector<9> v;
    Vector<3> acceleration;         // rad/s², before a step
    Matrix<Dynamic, 3> stops;       // (levels, 3) rad/s², mean of a new acceleration that stops the ball
    Matrix<Dynamic, KINDS> priors;  // (levels, kinds) probability of a step at one instant
    double volume;                  // factor of the likelihood by the determinant
    double square;                  // normalised square of z without a step, less z' R^-1 z
    double none = 0.0;              // probability of no step
    std::array<Instant, INSTANTS> instants;

    /// Return the share of the mode that becomes mode k without a step.
    double becomes(int k, double fade) const {
        const double left = mode > 0 ? fade : 1.0;
        return k == 0 ? left : (k == int(mode) ? 1.0 - left : 0.0);
    }

    /// Return the probability of a step at the level k.
    double at_level(int k) const {
        double sum = 0.0;
        for (const Instant& one : instants) sum += one.p.row(k).sum();
        return sum;
    }

    /// Return the mean of a step, rad/s², before the innovations are seen.
    Vector<3> mean_step(int level, int kind) const {
        if (kind == 0) return Vector<3>::Zero();
        if (kind == 1) return -acceleration;
        return stops.row(level).transpose() - acceleration;
    }
};

/// Moments of d, times their probability, over the instants of one mode.
struct Moments {
    double probability = 0.0;
    Vector<9> first = Vector<9>::Zero();
    Matrix<9> second = Matrix<9>::Zero(), within = Matrix<9>::Zero();
};

Given condition(const Matrix<16>& gram, const Matrix<6>& root, const Vector<6>& mean, const Matrix<6>& covariance) {
    Given r;
    Matrix<6> Q = lower(covariance);
    Vector<6> m = mean;
    solve_lower(root, Q);
    solve_lower(root, m);
    const Matrix<6> N = gram.topLeftCorner<6, 6>(), S = Matrix<6>::Identity() + Q.transpose() * N * Q;
    const Matrix<6> L = lower(S);
    Matrix<6> Y = Q.transpose();
    solve_lower(L, Y);
    r.C = Y.transpose() * Y;
    r.volume = 1.0 / L.diagonal().prod();
    const Vector<6> z = gram.block<6, 1>(0, 15), left = z - N * m;
    r.x = m + r.C * left;
    r.square = -m.dot(z + left) - left.dot(r.x - m);
    const Matrix<9, 6> D = gram.block<9, 6>(6, 0), DY = D * Y.transpose();
    r.A = gram.block<9, 9>(6, 6) - DY * DY.transpose();
    r.v = gram.block<9, 1>(6, 15) - D * r.x;
    r.Cd = Y.transpose() * DY.transpose();
    return r;
}

/// Return the probability of each level for a new step, after that of the last one.
///
/// In the long run the levels are as likely as `usual` (Metropolis et al. 1953).
Vector<Dynamic> after_step(const Vector<Dynamic>& at_level, const Vector<Dynamic>& usual) {
    Vector<Dynamic> r = at_level;
    for (int k = 0; k + 1 < r.size(); k++) {
        const double up = NEIGHBOUR * std::min(1.0, usual(k + 1) / usual(k)) * at_level(k);
        const double down = NEIGHBOUR * std::min(1.0, usual(k) / usual(k + 1)) * at_level(k + 1);
        r(k) += down - up;
        r(k + 1) += up - down;
    }
    return r;
}

/// Return the probability of each level for a step that stops a ball at `rate`, rad/s.
///
/// The rate determines it, whatever the last push was. It is the lowest level of which an acceleration stops the ball
/// until the next step on the average, or a neighbour.
Vector<Dynamic> of_stop(const Vector<3>& rate, const Steps& steps) {
    const Vector<Dynamic> variances = steps.variances.tail(steps.variances.size() - 1);
    Vector<Dynamic> needed = Vector<Dynamic>::Zero(variances.size());
    int k = 0;
    while (k + 1 < variances.size() && 3.0 * variances(k) * steps.between * steps.between < rate.squaredNorm()) k++;
    if (needed.size()) needed(k) = 1.0;
    return after_step(needed, steps.usual.tail(needed.size()));
}

/// Return the mean, rad/s², of an acceleration that stops a ball at `rate`, rad/s, until the next step.
///
/// It is at most as large as an acceleration of the level is on the average.
Vector<3> stopping(const Vector<3>& rate, double variance, double between) {
    return -std::min(1.0 / between, std::sqrt(3.0 * variance) / rate.norm()) * rate;
}

/// Weigh the levels and kinds of a step at one instant, and return the least square.
///
/// With the matrix inversion lemma no matrix is larger than 3x3 (Willsky and Jones 1976, "A generalized likelihood
/// ratio approach to the detection and estimation of jumps in linear systems").
double weigh(Instant& step, const Given& given, const Vector<Dynamic>& variances) {
    step.B.setZero();
    step.c.setZero();
    for (int i = 0; i < 3; i++) {
        step.c += step.g(i) * given.v.segment<3>(3 * i);
        for (int k = 0; k < 3; k++) step.B += step.g(i) * step.g(k) * given.A.block<3, 3>(3 * i, 3 * k);
    }
    step.p.setZero(variances.size(), KINDS);
    step.square.setConstant(variances.size(), KINDS, INFINITE);
    for (int k = 0; k < variances.size(); k++) {
        if (!(given.priors.row(k).maxCoeff() > 0.0)) continue;
        const Matrix<3> K = Matrix<3>::Identity() + variances(k) * step.B;
        const Matrix<3> C = variances(k) * K.inverse();
        step.p.row(k) = given.volume / std::sqrt(K.determinant()) * given.priors.row(k);
        for (int kind = 0; kind < KINDS; kind++) {
            if (!(given.priors(k, kind) > 0.0)) continue;
            const Vector<3> mean = given.mean_step(k, kind), y = step.c - step.B * mean;
            step.square(k, kind) = given.square - mean.dot(step.c + y) - y.dot(C * y);
        }
    }
    return step.square.size() ? step.square.minCoeff() : INFINITE;
}

/// Add p times the moments of a step at one instant. `mean` and `variance` are those before the innovations are seen.
void add(Moments& to, double p, const Instant& step, const Vector<3>& mean, double variance) {
    const Matrix<3> C = variance * (Matrix<3>::Identity() + variance * step.B).inverse();
    const Vector<3> size = mean + C * (step.c - step.B * mean);
    const Matrix<3> square = C + size * size.transpose();
    to.probability += p;
    for (int i = 0; i < 3; i++) {
        to.first.segment<3>(3 * i) += p * step.g(i) * size;
        for (int k = 0; k < 3; k++) {
            const double f = p * step.g(i) * step.g(k);
            to.second.block<3, 3>(3 * i, 3 * k) += f * square;
            to.within.block<3, 3>(3 * i, 3 * k) += f * C;
        }
    }
}

double total(const std::vector<Given>& given, int levels) {
    double sum = 0.0;
    for (const Given& one : given) {
        sum += one.none;
        for (int k = 0; k < levels; k++) sum += one.at_level(k);
    }
    return sum;
}

/// Set to zero the probability of each hypothesis that adds little to its mode.
void drop_minor(std::vector<Given>& given, int levels) {
    const double all = total(given, levels);
    for (int k = 0; k < levels; k++) {
        double of_level = 0.0;
        for (const Given& one : given) of_level += one.at_level(k);
        const double least = std::max(MINOR * of_level, 1e-3 * NEGLIGIBLE * all);
        for (Given& one : given)
            for (Instant& step : one.instants)
                step.p.row(k) = (step.p.row(k).array() < least).select(0.0, step.p.row(k));
    }
}

/// Join the hypotheses: all with the same new level become one mode.
void merge(const std::vector<Given>& given, const Effect& effect, const Vector<Dynamic>& variances, double fade,
           Posterior& r) {
    const int levels = int(variances.size());
    const Matrix<6> Tx = effect.T.leftCols<6>();
    r.mean.setZero();
    r.covariance.setZero();
    r.within.setZero();
    Vector<Dynamic> share = Vector<Dynamic>::Zero(1 + levels);
    r.modes.means.assign(1 + levels, Vector<6>::Zero());
    r.modes.covariances.assign(1 + levels, Matrix<6>::Zero());
    for (const Given& one : given) {
        const Vector<6> base = Tx * one.x;
        const Matrix<6, 9> M = effect.T.rightCols<9>() - Tx * one.Cd;
        const Matrix<6> spread = Tx * one.C * Tx.transpose() + base * base.transpose();
        Moments all;
        for (int k = 0; k <= levels; k++) {
            Moments d;
            d.probability = one.none * one.becomes(k, fade);
            for (const Instant& step : one.instants)
                for (int kind = 0; k > 0 && kind < KINDS; kind++)
                    if (step.p(k - 1, kind) > 0.0)
                        add(d, step.p(k - 1, kind), step, one.mean_step(k - 1, kind), variances(k - 1));
            if (d.probability == 0.0) continue;
            const Vector<6> moved = M * d.first;
            const Matrix<6> cross = base * moved.transpose();
            share(k) += d.probability;
            r.modes.means[k] += d.probability * base + moved;
            r.modes.covariances[k] += d.probability * spread + cross + cross.transpose() + M * d.second * M.transpose();
            all.probability += d.probability;
            if (k == 0) continue;
            all.first += d.first;
            all.second += d.second;
            all.within += d.within;
        }
        const Vector<6> back = one.Cd * all.first;
        const Matrix<6> cross = one.x * back.transpose();
        const Matrix<6, 9> half = one.Cd * all.second, inner = one.Cd * all.within;
        r.mean.head<6>() += all.probability * one.x - back;
        r.mean.tail<9>() += all.first;
        r.covariance.topLeftCorner<6, 6>() += all.probability * (one.C + one.x * one.x.transpose()) - cross -
                                              cross.transpose() + half * one.Cd.transpose();
        r.covariance.topRightCorner<6, 9>() += one.x * all.first.transpose() - half;
        r.covariance.bottomRightCorner<9, 9>() += all.second;
        r.within.topLeftCorner<6, 6>() += all.probability * one.C + inner * one.Cd.transpose();
        r.within.topRightCorner<6, 9>() -= inner;
        r.within.bottomRightCorner<9, 9>() += all.within;
    }
    r.covariance.bottomLeftCorner<9, 6>() = r.covariance.topRightCorner<6, 9>().transpose();
    r.within.bottomLeftCorner<9, 6>() = r.within.topRightCorner<6, 9>().transpose();
    r.covariance -= r.mean * r.mean.transpose();
    const Vector<6> mean = effect.T * r.mean;
    for (int k = 0; k <= levels; k++) {
        if (share(k) == 0.0) continue;
        r.modes.means[k] /= share(k);
        r.modes.covariances[k] =
            r.modes.covariances[k] / share(k) + effect.shared - r.modes.means[k] * r.modes.means[k].transpose();
        r.modes.means[k] -= mean;
    }
}

}  // namespace

Modes read_modes(nb::tuple arrays) {
    members(arrays, 3, "modes");
    const auto means = matrix<Dynamic, 6>(arrays[0], "means");
    const auto covariances = array<const double, -1, 6, 6>(arrays[1], "covariances");
    Modes modes{{}, {}, matrix(arrays[2], "weights")};
    if (nb::ssize_t(covariances.shape(0)) != means.rows() || modes.weights.rows() != means.rows())
        throw nb::type_error("modes: must have one length");
    for (int j = 0; j < means.rows(); j++) {
        modes.means.emplace_back(means.row(j).transpose());
        modes.covariances.emplace_back(View<6, 6>(covariances.data() + 36 * j));
    }
    return modes;
}

nb::tuple modes_to_numpy(const Modes& modes) {
    const size_t n = modes.means.size();
    auto means = zeros<double>({n, 6}), covariances = zeros<double>({n, 6, 6});
    for (size_t j = 0; j < n; j++) {
        std::copy_n(modes.means[j].data(), 6, means.data() + 6 * j);
        std::copy_n(modes.covariances[j].data(), 36, covariances.data() + 36 * j);
    }
    return nb::make_tuple(means, covariances, to_numpy(modes.weights));
}

Posterior posterior(const Matrix<16>& gram, const Effect& effect, const Vector<6>& motion, const Steps& steps,
                    const Modes& modes) {
    const int levels = int(steps.variances.size()) - 1;
    const double quiet = std::exp(-steps.interval / steps.between), fade = std::min(1.0, steps.interval / RESOLVED);
    const double chance = (1.0 - quiet) / INSTANTS;
    const double recent = (1.0 - std::exp(-std::max(steps.interval, RESOLVED) / steps.between)) / INSTANTS;
    const Vector<Dynamic> variances = steps.variances.tail(levels);
    std::vector<Given> given;
    std::vector<Vector<Dynamic>> kept;  // (1 + levels,) probability of no step
    double least = INFINITE;
    for (size_t j = 0; j < modes.means.size(); j++) {
        const Vector<Dynamic> weights = modes.weights.row(nb::ssize_t(j));
        if (weights.sum() < NEGLIGIBLE) continue;
        Given one = condition(gram, effect.root, modes.means[j], modes.covariances[j]);
        one.mode = j;
        const Vector<6> before = motion + modes.means[j];
        one.acceleration = before.tail<3>();
        one.stops.resize(levels, 3);
        for (int k = 0; k < levels; k++) one.stops.row(k) = stopping(before.head<3>(), variances(k), steps.between);
        kept.push_back(quiet * weights);
        kept.back()(0) = weights(0);
        one.none = kept.back().sum() * one.volume;
        const Vector<Dynamic> at_level = after_step(weights.tail(levels), steps.usual.tail(levels));
        one.priors = (at_level / KINDS).replicate<1, KINDS>();
        one.priors.col(KINDS - 1) = weights.tail(levels).sum() / KINDS * of_stop(before.head<3>(), steps);
        one.priors = (recent * KINDS * one.priors.array() > NEGLIGIBLE).select(chance * one.priors, 0.0).eval();
        least = std::min(least, one.square);
        for (int s = 0; s < INSTANTS; s++) {
            const double before = (s + 0.5) / INSTANTS * steps.interval;  // the frame, s
            one.instants[s].g = Vector<3>(0.5 * before * before, before, 1.0);
            least = std::min(least, weigh(one.instants[s], one, variances));
        }
        given.push_back(std::move(one));
    }
    for (Given& one : given) {
        one.none *= std::exp(-0.5 * (one.square - least));
        for (Instant& step : one.instants) step.p.array() *= (-0.5 * (step.square.array() - least)).exp();
    }
    drop_minor(given, levels);
    const double all = total(given, levels);
    Posterior r;
    r.modes.weights = Matrix<Dynamic>::Zero(1 + levels, 1 + levels);
    r.excess = 0.0;
    double mean_square = 0.0;
    for (size_t j = 0; j < given.size(); j++) {
        Given& one = given[j];
        one.none /= all;
        mean_square += one.none;
        if (one.none > 0.0) {
            r.excess += one.none * one.square;
            for (int k = 0; k <= levels; k++)
                r.modes.weights.row(k) += one.becomes(k, fade) * one.none / kept[j].sum() * kept[j];
        }
        for (Instant& step : one.instants) {
            step.p /= all;
            for (int k = 0; k < levels; k++) {
                const double p = step.p.row(k).sum();
                r.modes.weights(1 + k, 1 + k) += p;
                mean_square += p * variances(k) / steps.variances(0);
                for (int kind = 0; kind < KINDS; kind++)
                    if (step.p(k, kind) > 0.0) r.excess += step.p(k, kind) * step.square(k, kind);
            }
        }
    }
    merge(given, effect, variances, fade, r);
    r.level = std::sqrt(mean_square);
    r.log_ratio = std::log(all) - 0.5 * least;
    return r;
}

}  // namespace spheremouse::ball
