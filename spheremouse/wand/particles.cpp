// Draws of particles from the products of motions and likelihood peaks, and their weights. `particles.py` has the
// terms.
#include "spheremouse/wand/kernels.h"

namespace spheremouse::wand {
namespace {

using Vectors = Array<const double, -1, 6>;
using Matrices = Array<const double, -1, 6, 6>;
using Numbers = Array<const double, -1>;

/// Gaussian with the inverse of its covariance's Cholesky root.
struct Gaussian {
    Matrix<6> root, inverse;
    double log_norm;

    explicit Gaussian(const Matrix<6>& covariance) : root(covariance.llt().matrixL()) {
        inverse = root.triangularView<Eigen::Lower>().solve(Matrix<6>::Identity());
        log_norm = -3.0 * std::log(2.0 * PI) - root.diagonal().array().log().sum();
    }

    double log_density(const Vector<6>& d) const {
        return log_norm - 0.5 * (inverse.triangularView<Eigen::Lower>() * d).squaredNorm();
    }
};

/// Product of a motion and a peak, or a peak alone: `shift` gives its mean from the difference of motion and peak.
struct Component {
    Matrix<6> shift;
    Gaussian product;
};

/// Position, rotation vector of `to` from `from`.
Vector<6> difference(const Pose& from, const Pose& to) {
    Vector<6> d;
    d << from.c - to.c, log(from.R * to.R.transpose());
    return d;
}

Pose moved(const Pose& pose, const Vector<6>& shift, const Matrix3d& turn) {
    return {pose.c + shift.head<3>(), turn * pose.R};
}

/// Logarithm of the Haar measure per rad³ at a rotation vector: 2 (1 - cos a) / a².
double log_haar(const Vector<6>& d) {
    const double square = d.tail<3>().squaredNorm();
    if (square < 1e-4) return -square / 12.0;
    return std::log(std::max(2.0 * (1.0 - std::cos(std::sqrt(square))) / square, 1e-6));
}

/// Products of m motions with k peaks, in this order, then the k peaks alone: c = m k + k components.
class Proposal {
  public:
    Proposal(nb::handle shift_, nb::handle motion_covariance_, nb::handle probability_, double birth,
             nb::handle position_, nb::handle rotation_, nb::handle covariance_, nb::handle log_mass_)
        : birth_(birth) {
        const auto shift = array<const double, -1, 6>(shift_, "shift");
        const auto Q = array<const double, -1, 6, 6>(motion_covariance_, "motion_covariance");
        const auto probability = array<const double, -1>(probability_, "probability");
        const auto position = array<const double, -1, 3>(position_, "position");
        const auto rotation = array<const double, -1, 3, 3>(rotation_, "rotation");
        const auto P = array<const double, -1, 6, 6>(covariance_, "covariance");
        const auto log_mass = array<const double, -1>(log_mass_, "log_mass");
        const size_t m = shift.shape(0), k = position.shape(0);
        if (Q.shape(0) != m || probability.shape(0) != m)
            throw nb::type_error("shift: motions must have equal numbers");
        if (rotation.shape(0) != k || P.shape(0) != k || log_mass.shape(0) != k)
            throw nb::type_error("position: peaks must have equal numbers");
        for (size_t b = 0; b < k; b++)
            peaks_.push_back(
                {Eigen::Map<const Vector3d>(&position(b, 0)), Eigen::Map<const Matrix<3>>(&rotation(b, 0, 0))});
        for (size_t a = 0; a < m; a++) {
            const Matrix<6> motion = Eigen::Map<const Matrix<6>>(&Q(a, 0, 0));
            shift_vectors_.push_back(Eigen::Map<const Vector<6>>(&shift(a, 0)));
            turns_.push_back(exp(shift_vectors_[a].tail<3>()));
            motions_.emplace_back(motion);
            motions_[a].log_norm += std::log(probability(a));
            for (size_t b = 0; b < k; b++) {
                const Matrix<6> peak = Eigen::Map<const Matrix<6>>(&P(b, 0, 0)), sum = motion + peak;
                const Matrix<6> gain = sum.llt().solve(peak).transpose(), product = peak - gain * peak;
                evidence_.emplace_back(sum);
                evidence_.back().log_norm += std::log(probability(a)) + log_mass(b);
                components_.push_back({gain, Gaussian(0.5 * (product + product.transpose()))});
            }
        }
        for (size_t b = 0; b < k; b++)
            components_.push_back({Matrix<6>::Zero(), Gaussian(Eigen::Map<const Matrix<6>>(&P(b, 0, 0)))});
    }

    /// Return the logarithm of the weight of each product for particles (n,), (n, m k), and its difference, (n, m k,
    /// 6).
    nb::tuple score(nb::handle position_, nb::handle rotation_) const {
        const auto position = array<const double, -1, 3>(position_, "position");
        const auto rotation = array<const double, -1, 3, 3>(rotation_, "rotation");
        const size_t n = position.shape(0), k = peaks_.size(), products = evidence_.size();
        if (rotation.shape(0) != n) throw nb::type_error("rotation: must have as many poses as position");
        auto value = zeros<double>({n, products}), d = zeros<double>({n, products, 6});
        double *value_ = value.data(), *d_ = d.data();
        nb::gil_scoped_release release;
        for (size_t i = 0; i < n; i++) {
            const Pose pose = pose_at(position, rotation, i);
            for (size_t at = 0; at < products; at++) {
                const Pose ahead = moved(pose, shift_vectors_[at / k], turns_[at / k]);
                Eigen::Map<Vector<6>> to(d_ + 6 * (i * products + at));
                to = difference(ahead, peaks_[at % k]);
                value_[i * products + at] = evidence_[at].log_density(to);
            }
        }
        nb::gil_scoped_acquire acquire;
        return nb::make_tuple(value, d);
    }

    /// Draw poses from the components `chosen`, (n,), given the particles' differences and normal numbers, (n, 6).
    nb::tuple draw(nb::handle chosen_, nb::handle difference_, nb::handle normal_) const {
        const auto chosen = array<const int64_t, -1>(chosen_, "chosen");
        const auto d = array<const double, -1, -1, 6>(difference_, "difference");
        const auto normal = array<const double, -1, 6>(normal_, "normal");
        const size_t n = chosen.shape(0), products = evidence_.size();
        check(d, n);
        if (normal.shape(0) != n) throw nb::type_error("normal: must have a row for each particle");
        auto position = zeros<double>({n, 3}), rotation = zeros<double>({n, 3, 3});
        for (size_t i = 0; i < n; i++) {
            if (chosen(i) < 0 || size_t(chosen(i)) >= components_.size())
                throw nb::type_error("chosen: must be an index of a component");
            const size_t at = size_t(chosen(i));
            const Component& component = components_[at];
            Vector<6> x =
                component.product.root.triangularView<Eigen::Lower>() * Eigen::Map<const Vector<6>>(&normal(i, 0));
            if (at < products) x += component.shift * Eigen::Map<const Vector<6>>(&d(i, at, 0));
            const Pose& peak = peaks_[at % peaks_.size()];
            Eigen::Map<Vector3d>(position.data() + 3 * i) = peak.c + x.head<3>();
            Eigen::Map<Matrix<3>>(rotation.data() + 9 * i) = exp(x.tail<3>()) * peak.R;
        }
        return nb::make_tuple(position, rotation);
    }

    /// Return log p(x | parent) - log q(x | parent), (n,), and the index of the nearest peak, (n,).
    nb::tuple log_ratio(nb::handle base_position_, nb::handle base_rotation_, nb::handle position_,
                        nb::handle rotation_, nb::handle difference_, nb::handle responsibility_, double blind) const {
        const auto base_position = array<const double, -1, 3>(base_position_, "base_position");
        const auto base_rotation = array<const double, -1, 3, 3>(base_rotation_, "base_rotation");
        const auto position = array<const double, -1, 3>(position_, "position");
        const auto rotation = array<const double, -1, 3, 3>(rotation_, "rotation");
        const auto d = array<const double, -1, -1, 6>(difference_, "difference");
        const auto share = array<const double, -1, -1>(responsibility_, "responsibility");
        const size_t n = position.shape(0), k = peaks_.size();
        check(d, n);
        if (base_position.shape(0) != n || base_rotation.shape(0) != n || rotation.shape(0) != n ||
            share.shape(0) != n || share.shape(1) != components_.size())
            throw nb::type_error("responsibility: must have a row for each particle, a column for each component");
        auto ratio = zeros<double>({n});
        auto nearest = zeros<int64_t>({n});
        double* ratio_ = ratio.data();
        int64_t* nearest_ = nearest.data();
        nb::gil_scoped_release release;
        std::vector<Vector<6>> x(k);
        for (size_t i = 0; i < n; i++) {
            const Pose base = pose_at(base_position, base_rotation, i), pose = pose_at(position, rotation, i);
            double p = 0.0, q = 0.0, best = -1e300;
            for (size_t a = 0; a < motions_.size(); a++) {
                const Vector<6> e = difference(moved(base, shift_vectors_[a], turns_[a]), pose);
                p += std::exp(motions_[a].log_density(e) - log_haar(e));
            }
            for (size_t b = 0; b < k; b++) x[b] = difference(pose, peaks_[b]);
            for (size_t at = 0; at < components_.size(); at++) {
                Vector<6> e = x[at % k];
                if (at < evidence_.size()) e -= components_[at].shift * Eigen::Map<const Vector<6>>(&d(i, at, 0));
                const double fit = components_[at].product.log_density(e);
                if (share(i, at) > 0.0) q += share(i, at) * std::exp(fit - log_haar(x[at % k]));
                if (fit > best) best = fit, nearest_[i] = int64_t(at % k);
            }
            ratio_[i] =
                std::log(std::max(p + birth_, 1e-300)) - std::log(std::max((1.0 - blind) * q + blind * p, 1e-300));
        }
        nb::gil_scoped_acquire acquire;
        return nb::make_tuple(ratio, nearest);
    }

  private:
    static Pose pose_at(const Positions& position, const Rotations& rotation, size_t i) {
        return {Eigen::Map<const Vector3d>(&position(i, 0)), Eigen::Map<const Matrix<3>>(&rotation(i, 0, 0))};
    }

    void check(const Array<const double, -1, -1, 6>& difference, size_t n) const {
        if (difference.shape(0) != n || difference.shape(1) != evidence_.size())
            throw nb::type_error("difference: must have a row for each particle, a column for each product");
    }

    double birth_;
    std::vector<Pose> peaks_;
    std::vector<Vector<6>> shift_vectors_;
    std::vector<Matrix3d> turns_;
    std::vector<Gaussian> motions_, evidence_;  // of the motions, times their probability; of the products' weights
    std::vector<Component> components_;
};

}  // namespace

void bind_particles(nb::module_& m) {
    nb::class_<Proposal>(m, "Proposal")
        .def(nb::init<nb::handle, nb::handle, nb::handle, double, nb::handle, nb::handle, nb::handle, nb::handle>(),
             arg("shift"), arg("motion_covariance"), arg("probability"), arg("birth"), arg("position"), arg("rotation"),
             arg("covariance"), arg("log_mass"))
        .def("score", &Proposal::score, arg("position"), arg("rotation"))
        .def("draw", &Proposal::draw, arg("chosen"), arg("difference"), arg("normal"))
        .def("log_ratio", &Proposal::log_ratio, arg("base_position"), arg("base_rotation"), arg("position"),
             arg("rotation"), arg("difference"), arg("responsibility"), arg("blind"));
}

}  // namespace spheremouse::wand
