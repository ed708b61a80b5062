// The update by an ordinary frame in one call: its pairs are certain, and the correction is small.
#include <optional>

#include "spheremouse/ball/filters/so3.h"

namespace spheremouse::ball {
namespace {

constexpr double RARE = 1e-3;  // probability per frame below which chance does not explain the pairs

struct Updated {
    Pairs pairs;
    Corrected corrected;
    Moved moved;
};

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

/// Return whether one of the points falls by chance into the gate of a disc, given the other pairs.
bool pairs_by_chance(const Pairs& pairs, const Points& points, const Viewer& viewer, double gate) {
    return points.size() * gate * pairs.widest > 2.0 * RARE * (1.0 - viewer.horizon);
}

/// Return nothing unless the frame shows half of the discs or more in their places, without another possible pair.
std::optional<Updated> update_ordinary(const Body& body, const Points& points, const Viewer& viewer,
                                       const Pending& pending, const Activity& activity) {
    const Each squares = activity.squares();
    Updated r;
    r.pairs = pair(body, points, viewer, pending, pending.weights.dot(squares), activity.gate);
    const int k = int(r.pairs.rows.size());
    if (!(r.pairs.plain && r.pairs.in_place && k >= 2 && 2 * k >= r.pairs.possible)) return {};
    if (pairs_by_chance(r.pairs, points, viewer, activity.gate)) return {};
    if (k < r.pairs.possible &&
        pairs_if_livelier(body, points, viewer, r.pairs, pending.added(squares.maxCoeff()), activity.gate))
        return {};
    r.corrected = correct(body, r.pairs.innovation, pending, activity);
    if (is_large(r.corrected.dx)) return {};
    r.moved = move(body, r.corrected.dx, std::move(r.corrected.P));
    return r;
}

nb::object update_ordinary_(nb::tuple body_, nb::tuple points_, nb::tuple camera, nb::tuple sightings_,
                            nb::tuple pending_, nb::tuple activity_) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body);
    Viewer viewer = read_camera(camera);
    Sightings sightings = read_sightings(sightings_, body.known);
    const Activity activity = read_activity(activity_);
    const Pending pending = read_pending(pending_, body, activity);
    std::optional<Updated> r;
    {
        nb::gil_scoped_release release;
        r = update_ordinary(body, points, viewer, pending, activity);
        if (r) {
            viewer.covariance = r->moved.P.topLeftCorner<3, 3>();
            count(sightings, r->moved.attitude, r->moved.discs.topRows(body.known), viewer, r->pairs.columns, true);
        }
    }
    if (!r) return nb::none();
    return nb::make_tuple(corrected_to_numpy(r->moved, r->corrected), to_numpy(r->pairs.rows),
                          sightings_to_numpy(sightings));
}

}  // namespace

void bind_so3_ordinary(nb::module_& m) {
    m.attr("RARE") = RARE;
    m.def("update_ordinary", &update_ordinary_, arg("body"), arg("points"), arg("camera"), arg("sightings"),
          arg("pending"), arg("activity"));
}

}  // namespace spheremouse::ball
