// The pairs of a frame and the state that they correct, in one call.
#include "spheremouse/ball/filters/so3.h"

namespace spheremouse::ball {
namespace {

constexpr double RARE = 1e-3;         // probability per frame below which chance does not explain the pairs
constexpr double POINT_SIGMA = 2e-3;  // rad, of a seen direction: a tenth of a pixel on a ball 200 px across

/// Return whether an unpaired point and an unpaired visible disc form a pair at the highest level of the acceleration.
///
/// If they do, a hand may have pushed the ball. Then the update must not use only the discs that moved least.
bool another_pair_fits(const Body& body, const Points& points, const Viewer& viewer, const Pairs& pairs,
                       const Noise& added, double gate) {
    Indices others;
    for (int k : visible(body, viewer))
        if (std::find(pairs.columns.begin(), pairs.columns.end(), k) == pairs.columns.end()) others.push_back(k);
    Dense distance = distances(body, points, others, added, 0.0, gate);
    for (int i : pairs.rows) distance.row(i).setConstant(gate);
    return (distance.array() < gate).any();
}

/// Return whether any point falls into one disc's gate by chance in under a thousandth of the frames.
///
/// `root_determinant`, rad², is that of the covariance of the disc's place. The gate's area is proportional to it.
bool is_chance_rare(double root_determinant, const Points& points, const Viewer& viewer, double gate) {
    return points.size() * gate * root_determinant < 2.0 * RARE * (1.0 - viewer.horizon);
}

/// Return whether half of the possible pairs or more are in place, no other pair fits, and chance explains none.
bool are_ordinary(const Body& body, const Points& points, const Viewer& viewer, const Pairs& pairs,
                  const Pending& pending, const Activity& activity) {
    const int k = int(pairs.rows.size());
    if (!(pairs.plain && pairs.in_place && 2 * k >= pairs.possible)) return false;
    if (!is_chance_rare(pairs.widest, points, viewer, activity.gate)) return false;
    const double most = activity.squares().maxCoeff();
    return k == pairs.possible || !another_pair_fits(body, points, viewer, pairs, pending.added(most), activity.gate);
}

/// Return whether half of the points pair, and chance does not explain even the disc that is known least.
///
/// Several discs are no evidence for one whose place is uncertain: a false point beside it turns the ball.
bool are_known_well(const Body& body, const Points& points, const Viewer& viewer, const Pairs& pairs,
                    const Pending& pending, const Activity& activity) {
    if (2 * int(pairs.rows.size()) < points.size()) return false;
    const Noise added = pending.added(pending.weights.dot(activity.squares()));
    double largest_variance = 0.0;
    for (int k : pairs.columns) largest_variance = std::max(largest_variance, place_variance(body, k, added));
    return is_chance_rare(largest_variance + POINT_SIGMA * POINT_SIGMA, points, viewer, activity.gate);
}

nb::tuple update_by_frame(nb::tuple body_, nb::tuple points_, nb::tuple camera, nb::tuple pending_,
                          nb::tuple activity_) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body);
    const Viewer viewer = read_camera(camera);
    const Activity activity = read_activity(activity_);
    const Pending pending = read_pending(pending_, body, activity);
    Pairs pairs;
    bool certain = false;
    Corrected r;
    Moved moved;
    {
        nb::gil_scoped_release release;
        pairs = expected_pairs(body, points, viewer, pending, activity);
        certain = are_ordinary(body, points, viewer, pairs, pending, activity);
        if (!certain) pairs = likeliest_pairs(std::move(pairs), body, points, viewer, pending, activity);
        std::tie(r, moved) = correct_by_pairs(body, points, pairs, pending, activity);
        const bool is_small = log(Matrix<3>(moved.attitude * body.attitude.transpose())).norm() < LINEAR;
        certain = (certain && is_small) || are_known_well(body, points, viewer, pairs, pending, activity);
        certain = certain && pairs.rows.size() >= 2;
    }
    return nb::make_tuple(corrected_to_numpy(moved, r), pairs_to_numpy(pairs), certain);
}

}  // namespace

void bind_so3_frame(nb::module_& m) {
    m.attr("RARE") = RARE;
    m.attr("POINT_SIGMA") = POINT_SIGMA;
    m.def("update_by_frame", &update_by_frame, arg("body"), arg("points"), arg("camera"), arg("pending"),
          arg("activity"));
}

}  // namespace spheremouse::ball
