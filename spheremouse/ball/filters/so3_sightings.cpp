// Sightings of the discs on the map: how likely a disc is detected, and which discs leave the map.
//
// A disc is detected if it faces the camera, nothing hides it, and the detector finds it. A disc is hidden or not, as a
// Markov chain of two states with an observation in each frame (Thrun, Burgard and Fox 2005, section 4.2, the binary
// Bayes filter). A strut or a hand hides a disc until one of them moves. So a disc that is missed again and again while
// the ball rests counts once: repeated views of a still scene are not independent.
#include <numeric>

#include "spheremouse/ball/ball_view.h"
#include "spheremouse/ball/filters/so3.h"
#include "spheremouse/geometry/matching.h"

namespace spheremouse::ball {
namespace {

using Discs = Eigen::Ref<const Matrix<Dynamic, 3>>;

constexpr double PLACED = 0.1;        // rad, standard deviation: a third of the way between neighbours of fifty discs
constexpr double HIDDEN_SHARE = 0.2;  // of the discs that face the camera: struts and hands before them
constexpr double DETECTED = 0.95;     // probability that a disc is detected that nothing hides
// cosine above the horizon at which half of all discs are detected: foreshortened to a tenth
constexpr double LIMB = 0.1;
constexpr double LIMB_BLUR = 0.03;       // cosine over which that changes
constexpr int64_t ESTABLISHED_HITS = 3;  // frames in which a disc is seen until it is established
constexpr double MAX_TRIAL_MISSES = 3.0;
constexpr double MAX_MISSES_PER_HIT = 5.0;

/// What frames have shown of each disc.
struct Sightings {
    std::vector<int64_t> hits, missed;  // frames; those in a row
    Each hidden;                        // probability that something hides it
    std::vector<bool> keep;             // it stays on the map
    int known_seen = 0;                 // established discs
    double known_missed = 0.0;          // the same, expected number
};

/// Return the probabilities that discs are detected, over all attitudes that are possible.
///
/// The mean of a logistic function over a normal distribution is about that of a wider one (MacKay 1992, "The evidence
/// framework applied to classification networks").
Each detection_probability(const Matrix<3>& attitude, const Discs& discs, const Each& hidden, const Viewer& viewer) {
    Each probability(discs.rows());
    for (int k = 0; k < discs.rows(); k++) {
        const Vector<3> place = attitude * discs.row(k).transpose();
        const Vector<3> across = place.cross(viewer.towards);  // a turn e moves the cosine by e . across
        const double variance = across.dot(viewer.covariance * across);
        const double width = std::sqrt(LIMB_BLUR * LIMB_BLUR + M_PI / 8.0 * std::max(variance, 0.0));
        const double below = (viewer.horizon + LIMB - place.dot(viewer.towards)) / width;
        probability(k) = DETECTED / (1.0 + std::exp(std::min(below, 30.0))) * (1.0 - hidden(k));
    }
    return probability;
}

/// Return whether an attitude predicts each disc unambiguously: no other disc is as near.
bool is_placed(const Matrix<3>& covariance) {
    const Eigen::SelfAdjointEigenSolver<Matrix<3>> solver(covariance, Eigen::EigenvaluesOnly);
    return solver.eigenvalues()(2) < PLACED * PLACED;
}

Viewer read_viewer(nb::tuple viewer) {
    members(viewer, 3, "viewer");
    return {vector<3>(viewer[0], "towards"), number<double>(viewer[1], "viewer"),
            matrix<3, 3>(viewer[2], "covariance")};
}

/// Return one value for each disc, (m,).
template <class T>
Array<const T, -1> of_discs(nb::handle given, const char* name, nb::ssize_t m) {
    const auto values = array<const T, -1>(given, name);
    if (nb::ssize_t(values.shape(0)) != m)
        throw nb::type_error((std::string(name) + ": must have the length of discs").c_str());
    return values;
}

Each read_hidden(nb::handle hidden, nb::ssize_t m) {
    return Eigen::Map<const Each>(of_discs<double>(hidden, "hidden", m).data(), m);
}

NewArray<double> carry_hidden(nb::handle attitude_, nb::handle rate_, nb::handle discs_, nb::handle hidden_, double dt,
                              double disc_angle) {
    const auto attitude = matrix<3, 3>(attitude_, "attitude");
    const auto discs = matrix<Dynamic, 3>(discs_, "discs");
    const Vector<3> rate = attitude.transpose() * vector<3>(rate_, "rate");  // ball
    Each hidden = read_hidden(hidden_, discs.rows());
    for (int k = 0; k < discs.rows(); k++) {
        const double kept = std::exp(-moved_from_cover(rate, discs.row(k), dt, disc_angle));
        hidden(k) = HIDDEN_SHARE + (hidden(k) - HIDDEN_SHARE) * kept;
    }
    return to_numpy(hidden);
}

NewArray<double> detection_probability_(nb::handle attitude_, nb::handle discs_, nb::handle hidden_,
                                        nb::tuple viewer_) {
    const auto discs = matrix<Dynamic, 3>(discs_, "discs");
    const Matrix<3> attitude = matrix<3, 3>(attitude_, "attitude");
    return to_numpy(detection_probability(attitude, discs, read_hidden(hidden_, discs.rows()), read_viewer(viewer_)));
}

Sightings read_sightings(nb::tuple sightings, nb::ssize_t m) {
    members(sightings, 3, "sightings");
    const auto hits = of_discs<int64_t>(sightings[0], "hits", m), missed = of_discs<int64_t>(sightings[1], "missed", m);
    constexpr int64_t most = std::numeric_limits<int64_t>::max();
    for (nb::ssize_t k = 0; k < m; k++)
        if (hits(k) == most || missed(k) == most) throw nb::value_error("hits, missed: must be smaller");
    return {{hits.data(), hits.data() + m}, {missed.data(), missed.data() + m}, read_hidden(sightings[2], m), {}};
}

/// Count a frame that shows the discs `columns` in their places.
///
/// If it `may_miss` others, a disc is missed only where it should be. So frames in which the attitude is known too
/// badly count no miss.
void count(Sightings& r, const Matrix<3>& attitude, const Discs& discs, const Viewer& viewer, const Indices& columns,
           bool may_miss) {
    const Each cosine = discs * (attitude.transpose() * viewer.towards);
    const Each probability = detection_probability(attitude, discs, r.hidden, viewer);
    may_miss = may_miss && is_placed(viewer.covariance);
    std::vector<bool> seen(r.hits.size());
    for (int k : columns) seen[size_t(k)] = true;
    r.keep.resize(seen.size());
    // A disc near the horizon is often too thin to be detected.
    const double well = viewer.horizon + 0.5 * (1.0 - viewer.horizon);
    for (size_t k = 0; k < seen.size(); k++) {
        const double p = probability(nb::ssize_t(k));
        const bool misses = may_miss && !seen[k] && cosine(nb::ssize_t(k)) > well;
        if (r.hits[k] >= ESTABLISHED_HITS) {
            r.known_seen += seen[k];
            r.known_missed += misses ? p : 0.0;
        }
        r.hits[k] += seen[k];
        r.missed[k] = seen[k] ? 0 : r.missed[k] + misses;
        r.keep[k] = double(r.missed[k]) <
                    (r.hits[k] < ESTABLISHED_HITS ? MAX_TRIAL_MISSES : MAX_MISSES_PER_HIT * double(r.hits[k]));
        double& hidden = r.hidden(nb::ssize_t(k));
        hidden = seen[k] ? 0.0 : hidden / (1.0 - p);
    }
}

/// Let the discs leave the map that have their centre on another disc, seen more often.
///
/// That is a disc taken for a new one at a false attitude. Its place changes to the right one with the attitude.
void keep_apart(Sightings& r, const Discs& discs, double disc_angle) {
    Indices order(r.hits.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return r.hits[size_t(a)] > r.hits[size_t(b)]; });
    const Matrix<Dynamic, 3> sorted = discs(order, Eigen::all);
    const Each reach = Each::Constant(discs.rows(), 2.0 * std::sin(0.5 * disc_angle));
    std::vector<bool> apart(order.size());
    for (int i : suppress(View<>(sorted.data(), sorted.rows(), 3), reach)) apart[size_t(order[size_t(i)])] = true;
    for (size_t k = 0; k < apart.size(); k++) r.keep[k] = r.keep[k] && apart[k];
}

nb::tuple count_sightings(nb::handle attitude, nb::handle discs_, nb::tuple sightings_, nb::tuple viewer,
                          nb::handle columns_, bool may_miss, double disc_angle) {
    const auto discs = matrix<Dynamic, 3>(discs_, "discs");
    Sightings r = read_sightings(sightings_, discs.rows());
    const Indices columns = read_indices(columns_, "columns", int(discs.rows()));
    count(r, matrix<3, 3>(attitude, "attitude"), discs, read_viewer(viewer), columns, may_miss);
    keep_apart(r, discs, disc_angle);
    const auto keep = zeros<bool>({r.keep.size()});
    std::copy(r.keep.begin(), r.keep.end(), static_cast<bool*>(keep.data()));
    return nb::make_tuple(nb::make_tuple(to_numpy(r.hits), to_numpy(r.missed), to_numpy(r.hidden)), keep, r.known_seen,
                          r.known_missed);
}

}  // namespace

void bind_so3_sightings(nb::module_& m) {
    m.attr("PLACED") = PLACED;
    m.attr("HIDDEN_SHARE") = HIDDEN_SHARE;
    m.attr("ESTABLISHED_HITS") = ESTABLISHED_HITS;
    m.def("carry_hidden", &carry_hidden, arg("attitude"), arg("rate"), arg("discs"), arg("hidden"), arg("dt"),
          arg("disc_angle"));
    m.def("detection_probability", &detection_probability_, arg("attitude"), arg("discs"), arg("hidden"),
          arg("viewer"));
    m.def("count_sightings", &count_sightings, arg("attitude"), arg("discs"), arg("sightings"), arg("viewer"),
          arg("columns"), arg("may_miss"), arg("disc_angle"));
}

}  // namespace spheremouse::ball
