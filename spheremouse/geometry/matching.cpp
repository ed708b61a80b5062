#include "spheremouse/geometry/matching.h"

#include <limits>

namespace spheremouse {
namespace {

constexpr double MAX_WORTH = 1e100;  // sums of infinite worths are no numbers

using Worth = Eigen::Ref<const Matrix<Dynamic>>;

/// Return the result of `match` by shortest augmenting paths (Kuhn 1955, Munkres 1957).
///
/// Candidates are the columns that are worth something, and one spare column for each row. Rows and columns count from
/// 1. Column 0 holds the row that is being assigned.
std::vector<int> augment(const Worth& worth) {
    std::vector<int> wanted;
    for (int j = 0; j < worth.cols(); j++)
        if ((worth.col(j).array() > 0.0).any()) wanted.push_back(j);
    const size_t n = size_t(worth.rows()), k = wanted.size(), width = k + n + 1;
    std::vector<double> u(n + 1), v(width), least(width);
    std::vector<size_t> owner(width), before(width);
    std::vector<char> used(width);
    for (size_t row = 1; row <= n; row++) {
        owner[0] = row;
        size_t here = 0;
        least.assign(width, std::numeric_limits<double>::infinity());
        used.assign(width, false);
        do {
            used[here] = true;
            const size_t i = owner[here];
            double step = std::numeric_limits<double>::infinity();
            size_t following = 0;
            for (size_t j = 1; j < width; j++) {
                if (used[j]) continue;
                const double w = j <= k ? worth(int(i) - 1, wanted[j - 1]) : 0.0;
                const double reduced = -(w > 0.0 ? std::min(w, MAX_WORTH) : 0.0) - u[i] - v[j];
                if (reduced < least[j]) least[j] = reduced, before[j] = here;
                if (least[j] < step) step = least[j], following = j;
            }
            for (size_t j = 0; j < width; j++) {
                if (used[j])
                    u[owner[j]] += step, v[j] -= step;
                else
                    least[j] -= step;
            }
            here = following;
        } while (owner[here] != 0);
        for (; here != 0; here = before[here]) owner[here] = owner[before[here]];
    }
    std::vector<int> column(n, -1);
    for (size_t j = 1; j <= k; j++)
        if (owner[j] > 0 && worth(int(owner[j]) - 1, wanted[j - 1]) > 0.0) column[owner[j] - 1] = wanted[j - 1];
    return column;
}

}  // namespace

std::vector<int> match(const Worth& worth) {
    std::vector<int> column(size_t(worth.rows()), -1);
    std::vector<char> taken(size_t(worth.cols()));
    for (int i = 0; i < worth.rows(); i++) {
        int best = -1;
        for (int j = 0; j < worth.cols(); j++)
            if (worth(i, j) > (best < 0 ? 0.0 : worth(i, best))) best = j;
        if (best < 0) continue;
        if (taken[size_t(best)]) return augment(worth);
        taken[size_t(best)] = true;
        column[size_t(i)] = best;
    }
    return column;
}

std::vector<int> mutual_nearest(const Matrix<Dynamic>& distance) {
    std::vector<int> column(size_t(distance.rows()), -1);
    if (distance.size() == 0) return column;
    for (int i = 0; i < distance.rows(); i++) {
        int j = 0, nearest = 0;
        const double least = distance.row(i).minCoeff(&j);
        distance.col(j).minCoeff(&nearest);
        if (nearest == i && least < std::numeric_limits<double>::infinity()) column[size_t(i)] = j;
    }
    return column;
}

std::vector<int> suppress(const View<>& points, const Eigen::Ref<const Vector<Dynamic>>& radius, double norm) {
    std::vector<int> kept;
    for (int i = 0; i < points.rows(); i++) {
        const bool near = std::any_of(kept.begin(), kept.end(), [&](int k) {
            const auto offset = points.row(i) - points.row(k);
            return (std::isinf(norm) ? offset.cwiseAbs().maxCoeff() : offset.norm()) <= radius(k);
        });
        if (!near) kept.push_back(i);
    }
    return kept;
}

void bind_matching(nb::module_& m) {
    m.def("match", [](nb::handle worth) { return to_numpy(match(matrix(worth, "worth"))); }, arg("worth"));
    m.def(
        "mutual_nearest", [](nb::handle distance) { return to_numpy(mutual_nearest(matrix(distance, "distance"))); },
        arg("distance"));
    m.def(
        "suppress",
        [](nb::handle points_, nb::handle radius_, double norm) {
            const auto points = matrix(points_, "points");
            const auto radius = vector(radius_, "radius");
            if (points.rows() != radius.size()) throw nb::type_error("radius: must have the length of points");
            if (points.cols() == 0) throw nb::type_error("points: must have a column");
            return to_numpy(suppress(points, radius, norm));
        },
        arg("points"), arg("radius"), arg("norm") = 2.0);
}

}  // namespace spheremouse
