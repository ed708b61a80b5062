// Covers in front of a disc: where a strut or a sleeve cuts a disc, its edge is straight.
//
// A cover as light as the ball leaves only a dark part of the expected disc. The pixels inside of the expected ellipse
// show the edge whatever the cover's shade is, as long as it is lighter than the disc.
#include <numeric>
#include <optional>

#include "spheremouse/ball/detect/pixels.h"

namespace spheremouse::ball {
namespace {

constexpr float LIFTED = 0.15f;     // part of the contrast by which a cover is lighter than the disc, at least
constexpr double TWO_SHADES = 0.8;  // part of the variance of two shades, of which an even slope explains 0.75
constexpr double STRAY = 0.3;       // part of either side that may lie beyond a straight edge
constexpr double MARGIN = 2.0;      // px beside the edge that lens blur and smoothing mix with the cover
constexpr size_t LEAST_COVERED = 3, LEAST_DISC = 6;  // px of a cover and of a disc that show an edge

/// Sort `values`, and return how many Otsu's threshold (1979) counts as dark; 0 if they are not of two shades.
size_t darker_part(std::vector<float>& values, float ball) {
    std::sort(values.begin(), values.end());
    const double n = double(values.size()), sum = std::accumulate(values.begin(), values.end(), 0.0);
    double squares = 0.0, below = 0.0, low = 0.0, high = 0.0, most = 0.0;
    for (float v : values) squares += std::pow(v - sum / n, 2);
    size_t dark = 0;
    for (size_t k = 1; k < values.size(); k++) {
        below += values[k - 1];
        const double dark_mean = below / k, other_mean = (sum - below) / (n - k);
        const double between = k * (n - k) / n * std::pow(other_mean - dark_mean, 2);
        if (between > most) most = between, dark = k, low = dark_mean, high = other_mean;
    }
    return most > TWO_SHADES * squares && high - low > LIFTED * (ball - low) ? dark : 0;
}

/// A straight edge; a cover lies beyond it, normal' x > place.
struct Edge {
    Vector<2> normal;  // unit
    double place;      // px

    double beyond(const Pixels& p, size_t i) const { return normal(0) * p.x[i] + normal(1) * p.y[i] - place; }
};

/// Return the edge of a cover that cuts the disc.
std::optional<Edge> edge_of_cover(const Pixels& p, const Shape& shape) {
    const Shades shade = shades(p);
    if (!(shade.greatest - shade.least > LIFTED * (shade.ball - shade.least))) return {};
    std::vector<size_t> inside;
    std::vector<float> values;
    for (size_t i = 0; i < p.count; i++)
        if (shade.is_inside(p.e[i])) {
            inside.push_back(i);
            values.push_back(shade.value(p.grey[i], p.e[i]));
        }
    const size_t disc = darker_part(values, shade.ball), cover = values.size() - disc;
    if (disc < LEAST_DISC || cover < LEAST_COVERED) return {};
    const float middle = 0.5f * (values[disc - 1] + values[disc]);
    const auto is_cover = [&](size_t i) { return shade.value(p.grey[i], p.e[i]) > middle; };

    // a line cuts a circle into parts that have their centroids on one normal of the line
    const Shape to_circle = Shape(shape.llt().matrixL()).inverse();
    Vector<2> of_disc = Vector<2>::Zero(), of_cover = Vector<2>::Zero();
    for (size_t i : inside) (is_cover(i) ? of_cover : of_disc) += Vector<2>(p.x[i], p.y[i]);
    const Vector<2> between = to_circle * (of_cover / double(cover) - of_disc / double(disc));
    Edge edge{(to_circle.transpose() * between).normalized(), 0.0};
    std::vector<double> places;
    for (size_t i : inside) places.push_back(edge.beyond(p, i));
    std::nth_element(places.begin(), places.begin() + long(disc), places.end());
    edge.place = places[disc] - 0.5;
    const auto stray =
        std::count_if(inside.begin(), inside.end(), [&](size_t i) { return is_cover(i) != (edge.beyond(p, i) > 0.0); });
    if (double(stray) > STRAY * double(std::min(disc, cover)) + 2.0) return {};
    return edge;
}

}  // namespace

double leave_out_covered(Pixels& p, const Shape& shape) {
    const std::optional<Edge> edge = edge_of_cover(p, shape);
    if (!edge) return 1.0;
    double rim = 0.0, shown = 0.0;
    size_t kept = 0;
    for (size_t i = 0; i < p.count; i++) {
        const double slope = std::hypot(p.d[0][i], p.d[1][i]);
        rim += slope;
        if (edge->beyond(p, i) > -MARGIN) continue;
        shown += slope;
        p.exchange(i, kept++);
    }
    p.keep(kept);
    return shown / (rim + 1e-9);
}

}  // namespace spheremouse::ball
