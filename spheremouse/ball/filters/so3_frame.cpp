// The pairs of a frame and the state that they correct, in one call.
#include "spheremouse/ball/filters/so3.h"

namespace spheremouse::ball {
namespace {

constexpr double RARE = 1e-3;         // probability per frame below which chance does not explain the pairs
constexpr double POINT_SIGMA = 2e-3;  // rad, of a seen direction: a tenth of a pixel on a ball 200 px across

/// Return whether an unpaired point and an unpaired disc form a pair at the highest level.
///
/// If they do, a hand may have pushed the ball. Then the update must not use only the discs that moved least.
bool pairs_if_livelier(const Body& body, const Points& points, const Viewer& viewer, const Pairs& pairs,
                       const Noise& added, double gate) {
    Indices others;
    for (int k : visible(body, viewer))
        if (std::find(pairs.columns.begin(), pairs.columns.end(), k) == pairs.columns.end()) others.push_back(k);
    Dense distance = distances(body, points, others, added, 0.0, gate);
    for (int i : pairs.rows) distance.row(i).setConstant(gate);
    return (distance.array() < gate).any();
}

/// Return whether a point falls into the gate of a disc by chance in under a thousandth of the frames.
///
/// `area`, rad², is the root of the determinant of the covariance of the disc's place.
bool is_rare(double area, const Points& points, const Viewer& viewer, double gate) {
    return points.size() * gate * area < 2.0 * RARE * (1.0 - viewer.horizon);
}

/// Return whether pairs show half of the discs or more in their places, without another possible pair.
bool are_ordinary(const Body& body, const Points& points, const Viewer& viewer, const Pairs& pairs,
                  const Pending& pending, const Activity& activity) {
    const int k = int(pairs.rows.size());
    if (!(pairs.plain && pairs.in_place && 2 * k >= pairs.possible)) return false;
    if (!is_rare(pairs.widest, points, viewer, activity.gate)) return false;
    const double most = activity.squares().maxCoeff();
    return k == pairs.possible || !pairs_if_livelier(body, points, viewer, pairs, pending.added(most), activity.gate);
}

/// Return whether half of the points pair, and chance does not explain even the disc that is known least.
///
/// Several discs are no evidence for one whose place is uncertain: a false point beside it turns the ball.
bool are_known_well(const Body& body, const Points& points, const Viewer& viewer, const Pairs& pairs,
                    const Pending& pending, const Activity& activity) {
    if (2 * int(pairs.rows.size()) < points.size()) return false;
    const Noise added = pending.added(pending.weights.dot(activity.squares()));
    double widest = 0.0;
    for (int k : pairs.columns) widest = std::max(widest, place_variance(body, k, added));
    return is_rare(widest + POINT_SIGMA * POINT_SIGMA, points, viewer, activity.gate);
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
