#include "spheremouse/ball/constellation/hypotheses.h"

#include <limits>
#include <numeric>

namespace spheremouse::ball {
namespace {

constexpr int BINS = 256;                  // of the cosine between two known directions
constexpr double MIN_SQUARED_SINE = 1e-6;  // of half an angle: a smaller one, or that of the opposite direction, fixes
                                           // no attitude
constexpr double INF = std::numeric_limits<double>::infinity();

using Directions = Matrix<Dynamic, 3>;
using Pair = std::array<int, 2>;
using Columns = Matrix<3, Dynamic>;

double cosine_of(const Directions& u, int i, int j) { return std::clamp(u.row(i).dot(u.row(j)), -1.0, 1.0); }

/// Return the smaller one of squared sine and squared cosine of half an angle.
double squared_sine(double cosine) { return 0.5 * std::min(1.0 + cosine, 1.0 - cosine); }

/// Return all pairs within each of `groups` groups of distant directions, nearer pairs of a group first.
///
/// Any `groups` + 1 directions contain a pair, so every attitude with that many matches is found. No smaller set of
/// pairs has this property (Turan 1941).
std::vector<Pair> select_pairs(const Directions& seen, int groups) {
    const int n = int(seen.rows());
    groups = std::min(groups, std::max(n, 1));
    const Matrix<Dynamic> parallel = (seen * seen.transpose()).cwiseAbs();
    std::vector<std::vector<int>> members(static_cast<size_t>(groups));
    std::vector<char> taken(size_t(n), false);
    for (int g = 0; g < groups; g++) {
        Vector<Dynamic> nearest = Vector<Dynamic>::Zero(n);  // largest cosine with a member
        for (int left = n / groups + (g < n % groups); left > 0; left--) {
            int choice = -1;
            for (int i = 0; i < n; i++)
                if (!taken[size_t(i)] && (choice < 0 || nearest(i) < nearest(choice))) choice = i;
            members[size_t(g)].push_back(choice);
            taken[size_t(choice)] = true;
            nearest = nearest.cwiseMax(parallel.col(choice));
        }
    }
    std::vector<Pair> pairs;
    for (size_t step = 1; step <= size_t(n / groups); step++)
        for (const auto& group : members)
            for (size_t q = 0; q + step < group.size(); q++) pairs.push_back({group[q], group[q + step]});
    return pairs;
}

/// Return a symmetric triad of two directions: columns along u + v, u - v and their normal.
Matrix<3> triad(const Vector<3>& u, const Vector<3>& v) {
    Matrix<3> T;
    T.col(0) = (u + v).normalized();
    T.col(1) = (u - v).normalized();
    T.col(2) = T.col(0).cross(T.col(1));
    return T;
}

int bin(double cosine) { return int(std::min(std::max(0.0, (cosine + 1.0) * (BINS / 2)), BINS - 1.0)); }

/// Pairs of known directions, sorted into bins of their cosine.
struct PairTable {
    std::array<size_t, BINS + 1> first{};  // pair of each bin
    std::vector<Pair> pairs;
    std::vector<double> cosines;

    explicit PairTable(const Directions& known) {
        const int m = int(known.rows());
        const Matrix<Dynamic> cosine = known * known.transpose();
        for (int a = 0; a < m; a++)
            for (int b = a + 1; b < m; b++) first[size_t(bin(cosine(a, b))) + 1]++;
        std::partial_sum(first.begin(), first.end(), first.begin());
        pairs.resize(first.back());
        cosines.resize(first.back());
        auto place = first;
        for (int a = 0; a < m; a++)
            for (int b = a + 1; b < m; b++) {
                const size_t p = place[size_t(bin(cosine(a, b)))]++;
                pairs[p] = {a, b};
                cosines[p] = cosine(a, b);
            }
    }
};

/// Return the cosines of the i-th seen direction with the known ones, (3, m), at the attitude R, as an expression.
auto cosines(const Matrix<3>& R, const Matrix<Dynamic, 3>& seen, int i, const Columns& known) {
    const Vector<3> u = R.transpose() * seen.row(i).transpose();
    return known.row(0) * u(0) + known.row(1) * u(1) + known.row(2) * u(2);
}

/// The best rotations so far, and the traces of products above which two of them are alike.
struct Best {
    size_t max_count;
    double alike;
    std::vector<Matrix<3>> rotations;
    std::vector<double> scores;
    double needed = -INF;  // score for a place among them

    /// Insert a rotation, in place of a similar one or of the worst.
    void insert(const Matrix<3>& R, double score) {
        size_t place = 0;
        while (place < rotations.size() && !(R.cwiseProduct(rotations[place]).sum() > alike)) place++;
        if (place == max_count) place = size_t(std::min_element(scores.begin(), scores.end()) - scores.begin());
        if (place == rotations.size()) {
            rotations.push_back(R);
            scores.push_back(score);
        } else if (score > scores[place]) {
            rotations[place] = R;
            scores[place] = score;
        }
        if (scores.size() == max_count) needed = *std::min_element(scores.begin(), scores.end());
    }
};

/// Return the score of an attitude, or -1 if it is not above `needed`. This loop takes most of the time.
///
/// A direction near a known one scores `gain` less `weight` times 1 minus their cosine.
double score(const Matrix<3>& R, const Directions& seen, const Columns& known, double gain, double weight,
             double needed) {
    const int n = int(seen.rows());
    double total = 0.0;
    for (int i = 0; i < n; i++) {
        total += std::max(0.0, gain - (1.0 - cosines(R, seen, i, known).maxCoeff()) * weight);
        if (!(total + (n - 1 - i) * gain > needed)) return -1.0;
    }
    return total;
}

}  // namespace

Hypotheses::Hypotheses(nb::handle seen_, nb::handle known_, int groups, double tolerance, size_t max_count)
    : seen(matrix<Dynamic, 3>(seen_, "seen")), known(matrix<Dynamic, 3>(known_, "known")) {
    if (groups < 1) throw nb::value_error("groups: must be positive");
    nb::gil_scoped_release release;
    const PairTable table(known);
    for (const auto& [i, j] : select_pairs(seen, groups)) {
        const double cosine = cosine_of(seen, i, j), angle = std::acos(cosine);
        if (squared_sine(cosine) < MIN_SQUARED_SINE) continue;
        const double low = std::cos(std::min(M_PI, angle + tolerance)),
                     high = std::cos(std::max(0.0, angle - tolerance));
        const Matrix<3> S = triad(seen.row(i), seen.row(j));
        for (size_t p = table.first[size_t(bin(low))]; p < table.first[size_t(bin(high)) + 1]; p++) {
            const double c = table.cosines[p];
            if (!(low <= c && c <= high) || squared_sine(c) < MIN_SQUARED_SINE) continue;
            const auto [a, b] = table.pairs[p];
            for (const auto& [k, l] : {Pair{a, b}, Pair{b, a}}) {
                if (rotations.size() == max_count) return;
                rotations.push_back(S * triad(known.row(k), known.row(l)).transpose());
                origins.push_back({i, j, k, l});
            }
        }
    }
}

std::vector<Matrix<3>> Hypotheses::best(double sigma, double gain, double margin, size_t max_count) const {
    const Columns columns = known.transpose();
    Best found{max_count, 1.0 + 2.0 * std::cos(std::min(3.0 * sigma, M_PI)), {}, {}};
    double best = 2.0 * gain + margin;  // two directions define the hypothesis: others must match
    for (size_t h = 0; h < rotations.size(); h++) {
        // the error of the rotation increases the variance of another direction along the worst axis
        const double inflation = 1.0 + 0.5 / squared_sine(cosine_of(seen, int(origins[h][0]), int(origins[h][1])));
        const double total = score(rotations[h], seen, columns, gain, 1.0 / (sigma * sigma * inflation),
                                   std::max(best - margin, found.needed));
        if (total < 0.0) continue;
        found.insert(rotations[h], total);
        best = std::max(best, total);
    }
    std::vector<size_t> order(found.scores.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return found.scores[a] > found.scores[b]; });
    std::vector<Matrix<3>> kept;
    for (size_t h : order)
        if (found.scores[h] > best - margin) kept.push_back(found.rotations[h]);
    return kept;
}

std::pair<Matrix<3>, int> Hypotheses::most_common(double min_cosine) const {
    const Columns columns = known.transpose();
    const int n = int(seen.rows());
    Eigen::Array<bool, Dynamic, 1> matched(known.rows());
    std::pair<Matrix<3>, int> best{Matrix<3>::Identity(), 0};
    double trace = -INF;
    for (const Matrix<3>& R : rotations) {
        matched.setConstant(false);
        int rows = 0;
        for (int i = 0; i < n && rows + n - i >= best.second; i++) {
            const auto cosine = cosines(R, seen, i, columns);
            if (!(cosine.maxCoeff() > min_cosine)) continue;
            matched = matched || cosine.transpose().array() > min_cosine;
            rows++;
        }
        const int agreed = std::min(rows, int(matched.count()));
        if (agreed > best.second || (agreed == best.second && R.trace() > trace)) {
            best = {R, agreed};
            trace = R.trace();
        }
    }
    return best;
}

namespace {

NewArray<double> matrices_to_numpy(const std::vector<Matrix<3>>& rotations) {
    const Rows<3, 3> R(rotations.size());
    for (size_t h = 0; h < rotations.size(); h++) R[h] = rotations[h];
    return R.array;
}

NewArray<double> best(const Hypotheses& given, double sigma, double gain, double margin, size_t max_count) {
    if (max_count == 0) throw nb::value_error("max_count: must be positive");
    std::vector<Matrix<3>> found;
    {
        nb::gil_scoped_release release;
        found = given.best(sigma, gain, margin, max_count);
    }
    return matrices_to_numpy(found);
}

nb::tuple most_common(const Hypotheses& given, double min_cosine) {
    std::pair<Matrix<3>, int> found;
    {
        nb::gil_scoped_release release;
        found = given.most_common(min_cosine);
    }
    return nb::make_tuple(to_numpy(found.first), found.second);
}

NewArray<int64_t> origins(const Hypotheses& given) {
    auto origin = zeros<int64_t>({given.origins.size(), 4});
    for (size_t h = 0; h < given.origins.size(); h++) std::copy_n(given.origins[h].data(), 4, origin.data() + 4 * h);
    return origin;
}

}  // namespace

void bind_hypotheses(nb::module_& m) {
    nb::class_<Hypotheses>(m, "Hypotheses")
        .def(nb::init<nb::handle, nb::handle, int, double, size_t>(), arg("seen"), arg("known"), arg("groups"),
             arg("tolerance"), arg("max_count"))
        .def_prop_ro(
            "rotations", [](const Hypotheses& h) { return matrices_to_numpy(h.rotations); }, nb::rv_policy::move)
        .def_prop_ro("origins", &origins, nb::rv_policy::move)
        .def("best", &best, arg("sigma"), arg("gain"), arg("margin"), arg("max_count"))
        .def("most_common", &most_common, arg("min_cosine"));
}

}  // namespace spheremouse::ball
