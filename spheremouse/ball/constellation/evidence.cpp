// Adjustment of an attitude to directions, and its log evidence.
//
// `seen` (n, 3) and `known` (m, 3) are unit vectors, `variance` (n,) rad² that of each seen one per axis. A rotation
// maps `known` to `seen`.
#include <limits>

#include "spheremouse/ball/constellation/hypotheses.h"
#include "spheremouse/geometry/matching.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr int MAX_STEPS = 12;  // of matching and adjustment; most end after four
constexpr double INF = std::numeric_limits<double>::infinity();

using Directions = Eigen::Ref<const Matrix<Dynamic, 3>>;

/// Seen and known directions.
struct Scene {
    Directions seen, known;
    Eigen::Map<const Vector<Dynamic>> variance;
};

/// An attitude and its matches.
struct Attitude {
    Matrix<3> R;
    std::vector<int> column;   // index of the known direction of each seen one, or -1
    Matrix<3> information;     // 1/rad²
    double determinant = 0.0;  // of the information; 0 if it is singular
};

/// Known directions at an attitude.
struct Rotated {
    Matrix<Dynamic, 3> direction;
    Vector<Dynamic> visibility;  // probability of being visible without occlusion
};

/// Information and gradient of a small rotation.
struct Normal {
    Matrix<3> A = Matrix<3>::Zero();
    Vector<3> g = Vector<3>::Zero();
};

double log_sum_exp(const Vector<Dynamic>& terms) {
    const double top = terms.maxCoeff();
    return std::isinf(top) ? top : top + std::log((terms.array() - top).exp().sum());
}

double log_odds(double p) { return std::log(p / (1.0 - p)); }

/// Return the normal equations of a rotation of the known directions p, (m, 3).
Normal normal_equations(const Matrix<Dynamic, 3>& p, const std::vector<int>& column, const Scene& scene) {
    Normal e;
    for (int i = 0; i < scene.seen.rows(); i++) {
        if (column[size_t(i)] < 0) continue;
        const Vector<3> q = p.row(column[size_t(i)]), s = scene.seen.row(i);
        e.g += q.cross(s) / scene.variance(i);
        e.A += (Matrix<3>::Identity() - q * q.transpose()) / scene.variance(i);
    }
    return e;
}

/// Return the determinant, or 0 if the matrix is nearly singular.
double regular_determinant(const Matrix<3>& A) {
    const double det = A.determinant();
    return det > 1e-9 * std::pow(A.trace(), 3) ? det : 0.0;
}

/// Observation model of a ball at a known attitude.
struct ObservationModel {
    Vector<3> view_axis;
    double half_cosine, limb_width, detection_probability;
    Vector<Dynamic> miss_probabilities, sigma_scales;
    double false_mean, area;

    ObservationModel(nb::handle view_axis_, double half_cosine_, double limb_width_, double detection_probability_,
                     nb::handle miss_probabilities_, nb::handle sigma_scales_, double false_mean_, double area_)
        : view_axis(vector<3>(view_axis_, "view_axis")),
          half_cosine(half_cosine_),
          limb_width(limb_width_),
          detection_probability(detection_probability_),
          miss_probabilities(vector(miss_probabilities_, "miss_probabilities")),
          sigma_scales(vector(sigma_scales_, "sigma_scales")),
          false_mean(false_mean_),
          area(area_) {
        if (miss_probabilities.size() == 0 || sigma_scales.size() == 0)
            throw nb::type_error("miss_probabilities, sigma_scales: must not be empty");
    }

    double max_log_likelihood_ratio(double variance) const {
        const double density = 2.0 * false_mean / (1.0 + false_mean) / area;
        return log_odds(detection_probability) - std::log(2.0 * M_PI * variance * density);
    }

    double false_log_density(int k, double mean) const {
        const double rate = mean / (1.0 + mean);
        return std::log(1.0 - rate) + k * std::log(rate / area) + std::lgamma(k + 1.0);
    }

    Rotated rotated(const Matrix<3>& R, const Directions& known) const {
        Rotated r{known * R.transpose(), {}};
        r.visibility =
            (1.0 + ((half_cosine - (r.direction * view_axis).array()) / limb_width).min(50.0).exp()).inverse();
        return r;
    }

    Matrix<Dynamic> match_ratios(const Rotated& p, const Scene& scene, double widening) const;
    Attitude refined(const Matrix<3>& start, const Scene& scene, double first) const;
    double log_evidence(const Attitude& a, const Scene& scene) const;
    double two_match_log_evidence(const Hypotheses& given, nb::handle variance, size_t sample_size) const;
    nb::tuple refine_attitudes(nb::handle starts, nb::handle seen, nb::handle known, nb::handle variance,
                               double first) const;
};

/// Return log likelihood ratios, (n, m), of a match of two directions against a false and an unseen one.
Matrix<Dynamic> ObservationModel::match_ratios(const Rotated& p, const Scene& scene, double widening) const {
    const int n = int(scene.seen.rows()), m = int(scene.known.rows());
    const Matrix<Dynamic> cosine = scene.seen * p.direction.transpose();
    const Vector<Dynamic> seen_probability = detection_probability * p.visibility;
    Matrix<Dynamic> ratio = Matrix<Dynamic>::Constant(n, m, -1.0);
    for (int i = 0; i < n; i++) {
        const double exact_match = max_log_likelihood_ratio(scene.variance(i)), variance = widening * scene.variance(i);
        for (int j = 0; j < m; j++)
            if (p.visibility(j) >= 1e-4 && cosine(i, j) > 1.0 - variance * exact_match)
                ratio(i, j) = log_odds(seen_probability(j)) - log_odds(detection_probability) + exact_match -
                              (1.0 - cosine(i, j)) / variance;
    }
    return ratio;
}

/// Alternate one-to-one matches and Gauss-Newton steps of Wahba's problem.
Attitude ObservationModel::refined(const Matrix<3>& start, const Scene& scene, double first) const {
    Attitude a{start, {}, {}};
    for (int step = 0; step < MAX_STEPS; step++) {
        const Rotated p = rotated(a.R, scene.known);
        const std::vector<int> column = match(match_ratios(p, scene, step == 0 ? first : 1.0));
        const bool same = step > 1 && column == a.column;
        const Normal e = normal_equations(p.direction, column, scene);
        a.column = column;
        a.information = e.A;
        a.determinant = regular_determinant(e.A);
        if (a.determinant == 0.0) break;
        const Vector<3> v = e.A.inverse() * e.g;
        a.R = exp(v) * a.R;
        if (same && e.g.dot(v) < 1e-8) break;  // 1e-4 standard deviations; the rest is far smaller after this step
    }
    return a;
}

/// Return the log density of all seen and unseen directions, integrated over attitudes (Laplace 1774).
///
/// The prior over attitudes is uniform.
double ObservationModel::log_evidence(const Attitude& a, const Scene& scene) const {
    if (a.determinant <= 0.0) return -INF;
    const Rotated p = rotated(a.R, scene.known);
    std::vector<char> matched(size_t(scene.known.rows()), false);
    int k = 0;
    double square = 0.0, logs = 0.0;
    for (int i = 0; i < scene.seen.rows(); i++) {
        const int j = a.column[size_t(i)];
        if (j < 0) continue;
        k++;
        matched[size_t(j)] = true;
        square += (scene.seen.row(i) - p.direction.row(j)).squaredNorm() / scene.variance(i);
        logs += std::log(2.0 * M_PI * scene.variance(i));
    }
    // as a fraction of all attitudes
    const double width = 1.5 * std::log(2.0 * M_PI) - 0.5 * std::log(a.determinant) - std::log(8.0 * M_PI * M_PI);
    Vector<Dynamic> noise(sigma_scales.size()), visibility = Vector<Dynamic>::Zero(miss_probabilities.size());
    for (int s = 0; s < noise.size(); s++) {
        const double scale = sigma_scales(s), log_scale = std::log(scale);
        noise(s) = std::min(0.0, width + 3.0 * log_scale) - 2.0 * k * log_scale - 0.5 * square / (scale * scale);
    }
    for (int j = 0; j < scene.known.rows(); j++)
        for (int q = 0; q < visibility.size() && p.visibility(j) > 1e-4; q++) {
            const double chance = (1.0 - miss_probabilities(q)) * p.visibility(j);
            visibility(q) += std::log(matched[size_t(j)] ? chance : 1.0 - chance);
        }
    return log_sum_exp(noise) - logs + log_sum_exp(visibility) - std::log(double(noise.size() * visibility.size())) +
           false_log_density(int(scene.seen.rows()) - k, false_mean);
}

Scene scene_of(const Directions& seen, const Directions& known, nb::handle variance) {
    const Scene scene{seen, known, vector(variance, "variance")};
    if (scene.variance.size() != seen.rows()) throw nb::type_error("variance: must have the length of seen");
    return scene;
}

nb::tuple ObservationModel::refine_attitudes(nb::handle starts_, nb::handle seen, nb::handle known, nb::handle variance,
                                             double first) const {
    const auto starts = array<const double, -1, 3, 3>(starts_, "starts");
    const Scene scene = scene_of(matrix<Dynamic, 3>(seen, "seen"), matrix<Dynamic, 3>(known, "known"), variance);
    const size_t count = starts.shape(0), n = size_t(scene.seen.rows());
    auto R = zeros<double>({count, 3, 3}), information = zeros<double>({count, 3, 3}), value = zeros<double>({count});
    auto columns = zeros<int64_t>({count, n});
    {
        nb::gil_scoped_release release;
        std::vector<Attitude> found;
        for (size_t s = 0; s < count; s++) {
            const Attitude a = refined(View<3, 3>(starts.data() + 9 * s), scene, first);
            const bool repeated =
                std::any_of(found.begin(), found.end(), [&](const Attitude& b) { return a.column == b.column; });
            std::copy_n(a.R.data(), 9, R.data() + 9 * s);
            std::copy_n(a.information.data(), 9, information.data() + 9 * s);
            std::copy_n(a.column.begin(), n, columns.data() + n * s);
            value.data()[s] = repeated ? -INF : log_evidence(a, scene);
            found.push_back(a);
        }
    }
    return nb::make_tuple(R, columns, information, value);
}

double ObservationModel::two_match_log_evidence(const Hypotheses& given, nb::handle variance,
                                                size_t sample_size) const {
    const Scene scene = scene_of(given.seen, given.known, variance);
    const size_t count = given.rotations.size(), step = std::max<size_t>(1, count / std::max<size_t>(1, sample_size));
    nb::gil_scoped_release release;
    std::vector<double> terms;
    for (size_t h = 0; h < count; h += step) {
        Attitude a{given.rotations[h], std::vector<int>(size_t(scene.seen.rows()), -1), {}};
        for (size_t k : {0, 1}) a.column[size_t(given.origins[h][k])] = given.origins[h][2 + k];
        a.information = normal_equations(rotated(a.R, scene.known).direction, a.column, scene).A;
        a.determinant = regular_determinant(a.information);
        terms.push_back(log_evidence(a, scene));
    }
    if (terms.empty()) return -INF;
    const auto all = Eigen::Map<const Vector<Dynamic>>(terms.data(), nb::ssize_t(terms.size()));
    return log_sum_exp(all) + std::log(double(count) / double(terms.size()));
}

}  // namespace

void bind_evidence(nb::module_& m) {
    nb::class_<ObservationModel>(m, "ObservationModel")
        .def(nb::init<nb::handle, double, double, double, nb::handle, nb::handle, double, double>(), arg("view_axis"),
             arg("half_cosine"), arg("limb_width"), arg("detection_probability"), arg("miss_probabilities"),
             arg("sigma_scales"), arg("false_mean"), arg("area"))
        .def("max_log_likelihood_ratio", &ObservationModel::max_log_likelihood_ratio, arg("variance"))
        .def("false_log_density", &ObservationModel::false_log_density, arg("k"), arg("mean"))
        .def("refine_attitudes", &ObservationModel::refine_attitudes, arg("starts"), arg("seen"), arg("known"),
             arg("variance"), arg("first"))
        .def("two_match_log_evidence", &ObservationModel::two_match_log_evidence, arg("hypotheses"), arg("variance"),
             arg("sample_size"));
}

}  // namespace spheremouse::ball
