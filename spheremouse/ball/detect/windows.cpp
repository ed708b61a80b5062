// Measurement of discs, each in its own window, as `windows.py` describes it.
#include <limits>

#include "spheremouse/ball/detect/disc_model.h"
#include "spheremouse/geometry/matching.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr double EXPECTED = 0.3;    // of the contrast suffices at a place that the map predicts: glare, deep shade
constexpr double UNEXPECTED = 0.5;  // of the usual one elsewhere: the edge of a strut has less
constexpr double APART = 0.3;       // of a disc's diameter: of two nearer discs, the one with the worse fit is left out
constexpr double FAR = 1.0;         // px off the expected place, from which the disc has another shape
constexpr int MOST_AGAIN = 3;       // fits of a disc that is far off

/// A disc whose image is large enough and wholly in the picture.
struct Disc {
    Appearance seen;
    double moved;  // diameters on the ball since the last view, as expected
    Fit fit;       // with the disc's centre in place of the centroid
};

/// Return how far a disc moves between two views, in its diameters; infinite if there is no view before.
double moved(const BallView& view, const Vector<3>& direction, const Motion& motion) {
    if (!(motion.interval > 0.0)) return std::numeric_limits<double>::infinity();
    return moved_from_cover(motion.rate, direction, motion.interval, view.disc_angle);
}

/// Return the number of views of a disc in which a cover shifts its centre alike.
///
/// The errors of two views have a correlation c, which fades as the disc moves on by its diameter. The mean of many
/// such errors is as exact as that of independent ones with a variance (1 + c) / (1 - c) times as large.
double repeats(double moved) { return 1.0 / std::tanh(0.5 * moved); }

/// Return a direction when its row is read.
Vector<3> at_readout(const BallView& view, const Vector<3>& direction, const Motion& motion) {
    const double row = seen_at(view, direction)(1);
    if (motion.readout == 0.0 || !std::isfinite(row)) return direction;
    return exp(motion.readout * row_of(view.camera, row) * motion.rate) * direction;
}

/// Return the motion of a disc during the exposure (`Expected`), from its images at both ends and at mid-exposure.
///
/// The shape of a disc that is not whole at both ends counts as constant.
Vector<7> path_of(const DiscModel& model, const Vector<3>& direction, const Vector<2>& centre, const Vector<3>& rate) {
    Vector<7> path = Vector<7>::Zero();
    if (!(model.exposure > 0.0)) return path;
    const BallView& view = model.view;
    const Matrix<3> R = exp(0.5 * model.exposure * rate);
    const Vector<3> first = R.transpose() * direction, last = R * direction;
    const Vector<2> from = seen_at(view, first), to = seen_at(view, last);
    if (!(from + to).allFinite()) return path;
    path.head<2>() = to - from;
    path.segment<2>(2) = 2.0 * (to + from - 2.0 * centre);
    const Shape A = appearance(view, first).shape, B = appearance(view, last).shape;
    const Shape change = B.inverse() - A.inverse();
    if (change.allFinite()) path.tail<3>() << change(0, 0), change(0, 1), change(1, 1);
    return path;
}

bool is_inside(const Appearance& a, const Mask& mask) {
    const double dx = std::sqrt(a.shape(0, 0)), dy = std::sqrt(a.shape(1, 1)), x = a.centroid(0), y = a.centroid(1);
    return x - dx > -0.5 && x + dx < double(mask.shape(1)) - 0.5 && y - dy > -0.5 &&
           y + dy < double(mask.shape(0)) - 0.5;
}

/// Return the discs in the order of their fits, without those that are nearer to a better one than `apart` px.
std::vector<Measured> best_of(const std::vector<Disc>& discs, double apart) {
    std::vector<const Disc*> order;
    for (const Disc& disc : discs)
        if (disc.fit.ok) order.push_back(&disc);
    std::stable_sort(order.begin(), order.end(), [](auto a, auto b) { return a->fit.rim > b->fit.rim; });
    const nb::ssize_t n = nb::ssize_t(order.size());
    Matrix<Dynamic, 2> place(n, 2);
    for (nb::ssize_t i = 0; i < n; i++) place.row(i) = order[size_t(i)]->fit.centroid;
    std::vector<Measured> kept;
    for (int i : suppress(View<>(place.data(), n, 2), Vector<Dynamic>::Constant(n, apart)))
        kept.push_back({order[size_t(i)]->fit.centroid, order[size_t(i)]->fit.covariance, order[size_t(i)]->seen.area});
    return kept;
}

nb::tuple measure_places_(nb::handle image, nb::handle places_, nb::handle model_, double noise, double usual,
                          double size) {
    const auto [model, photo] = read_model(model_, image, noise);
    const auto given = matrix<Dynamic, 2>(places_, "places");
    std::vector<Vector<2>> places(size_t(given.rows()));
    for (size_t i = 0; i < places.size(); i++) places[i] = given.row(nb::ssize_t(i));
    std::vector<Measured> found;
    {
        nb::gil_scoped_release release;
        found = measure_places(photo, places, model, {size, usual});
    }
    return to_numpy(found);
}

/// Expect a disc where its fit ended; return false if it would not be seen there.
bool expect_at_fit(const Photo& photo, const DiscModel& model, const Vector<3>& rate, const Fit& fit, Disc& disc,
                   Expected& expected) {
    const Vector<2> centre = fit.centroid - disc.seen.centroid + disc.seen.centre;
    const Hit hit = first_hit(model.view, unproject(model.view.camera, centre).place);
    if (!hit.met) return false;
    const Vector<3> direction = (hit.point - model.view.centre) / model.view.radius;
    const Appearance seen = appearance(model.view, direction);
    if (!(seen.area >= model.min_area) || !is_inside(seen, photo.mask)) return false;
    disc.seen = seen;
    expected = {seen.centroid, seen.shape, path_of(model, direction, seen.centre, rate)};
    return true;
}

/// Fit discs. Fit those far from their expected places again, up to three times, with the shapes that they have there.
///
/// A push takes discs farther than the steps of one fit, and so does a start at the middle of what a cover leaves. A
/// disc that is still far after these is rejected: its fits slide along an edge. With `any_start`, a start may be so
/// wrong that the first fit is no disc. A smeared disc keeps its first fit: off its place it also moves otherwise.
std::vector<Fit> fit_in_place(const Photo& photo, const DiscModel& model, const Vector<3>& rate, double contrast,
                              bool any_start, std::vector<Disc>& discs, std::vector<Expected> expected,
                              Common& common) {
    const Common before = common;
    std::vector<Fit> fits = fit_discs(photo, expected, model.fit, contrast, common);
    for (int round = 0;; round++) {
        bool any_far = false;
        for (size_t i = 0; i < discs.size(); i++) {
            const bool counts = fits[i].ok || (any_start && fits[i].rim > 0.0);
            if (!(counts && !expected[i].is_smeared() && (fits[i].centroid - expected[i].place).norm() > FAR)) continue;
            fits[i].ok = false;
            any_far |= round < MOST_AGAIN && expect_at_fit(photo, model, rate, fits[i], discs[i], expected[i]);
        }
        if (!any_far) return fits;
        common = before;
        fits = fit_discs(photo, expected, model.fit, contrast, common);
    }
}

/// Fit discs, correct eccentricity, and add the covariance of a cover's repeated errors. Return the distinct best.
std::vector<Measured> fit_all(const Photo& photo, const DiscModel& model, const Vector<3>& rate, double contrast,
                              bool any_start, std::vector<Disc>& discs, const std::vector<Expected>& expected,
                              Common& common) {
    const std::vector<Fit> fits = fit_in_place(photo, model, rate, contrast, any_start, discs, expected, common);
    for (size_t i = 0; i < discs.size(); i++) {
        discs[i].fit = fits[i];
        discs[i].fit.centroid -= discs[i].seen.centroid - discs[i].seen.centre;                // the eccentricity
        const double beside = (fits[i].centroid - expected[i].place).norm() / model.diameter;  // of the expected place
        discs[i].fit.covariance += (repeats(discs[i].moved + beside) - 1.0) * fits[i].by_cover;
    }
    return best_of(discs, APART * model.diameter);
}

}  // namespace

std::pair<DiscModel, Photo> read_model(nb::handle given, nb::handle image, double noise) {
    const nb::tuple model = members(given, 6, "model");
    const FitSettings fit = read_fit_settings(model[3]);
    return {{read_ball_view(model[0]), number<double>(model[2], "model"), fit, number<double>(model[4], "model"),
             number<double>(model[5], "model")},
            read_photo(image, model[1], nb::borrow<nb::tuple>(model[3])[0], noise)};
}

Motion read_motion(nb::handle given) {
    const nb::tuple motion = members(given, 3, "motion");
    return {vector<3>(motion[0], "rate"), number<double>(motion[1], "motion"), number<double>(motion[2], "motion")};
}

std::vector<Measured> measure(const Photo& photo, const Directions& directions, const DiscModel& model,
                              const Motion& motion, Common& common) {
    std::vector<Disc> discs;
    std::vector<Expected> expected;
    for (nb::ssize_t i = 0; i < directions.rows(); i++) {
        const Vector<3> direction = at_readout(model.view, directions.row(i), motion);
        const Appearance seen = appearance(model.view, direction);
        if (!(seen.area >= model.min_area) || !is_inside(seen, photo.mask)) continue;
        discs.push_back({seen, moved(model.view, direction, motion), {}});
        expected.push_back({seen.centroid, seen.shape, path_of(model, direction, seen.centre, motion.rate)});
    }
    const double contrast = EXPECTED * std::max(model.fit.contrast, common.contrast);
    return fit_all(photo, model, motion.rate, contrast, false, discs, expected, common);
}

std::vector<Measured> measure_places(const Photo& photo, const std::vector<Vector<2>>& places, const DiscModel& model,
                                     Common common) {
    std::vector<Disc> discs;
    std::vector<Expected> expected;
    for (const Vector<2>& place : places) {
        const Hit hit = first_hit(model.view, unproject(model.view.camera, place).place);
        if (!hit.met) continue;
        const Appearance seen = appearance(model.view, (hit.point - model.view.centre) / model.view.radius);
        if (!(seen.area >= model.min_area) || !is_inside(seen, photo.mask)) continue;
        discs.push_back({seen, std::numeric_limits<double>::infinity(), {}});
        expected.push_back({place, seen.shape, Vector<7>::Zero()});
    }
    const double contrast = std::max(model.fit.contrast, UNEXPECTED * common.contrast);
    const bool any_start = common.size > 0.0;  // else the size separates discs from other dark spots
    return fit_all(photo, model, Vector<3>::Zero(), contrast, any_start, discs, expected, common);
}

void bind_windows(nb::module_& m) {
    m.def("measure_places", &measure_places_, arg("image"), arg("places"), arg("model"), arg("noise"), arg("usual"),
          arg("size"));
}

}  // namespace spheremouse::ball
