// Measurement of discs, each in its own window, as `windows.py` describes it.
#include "spheremouse/ball/detect/disc_model.h"
#include "spheremouse/geometry/matching.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr double EXPECTED = 0.3;  // of the contrast suffices at a place that the map predicts: glare, deep shade
constexpr double APART = 0.3;     // of a disc's diameter: of two nearer discs, the one with the worse fit is left out

/// Motion of the ball during a frame, `windows.Motion`.
struct Motion {
    Vector<3> rate;   // rad/s, obj
    double readout;   // s, of all rows
    double exposure;  // s
};

/// A disc whose image is large enough and wholly in the picture.
struct Disc {
    Appearance seen;
    Fit fit;  // with the disc's centre in place of the centroid
};

/// Return a direction when its row is read.
Vector<3> at_readout(const BallView& view, const Vector<3>& direction, const Motion& motion) {
    const double row = seen_at(view, direction)(1);
    if (motion.readout == 0.0 || !std::isfinite(row)) return direction;
    return exp(motion.readout * row_of(view.camera, row) * motion.rate) * direction;
}

/// Return the motion of a disc during the exposure (`Expected`), from its images at both ends and at mid-exposure.
///
/// The shape of a disc that is not whole at both ends counts as constant.
Vector<7> path_of(const BallView& view, const Vector<3>& direction, const Vector<2>& centre, const Motion& motion) {
    Vector<7> path = Vector<7>::Zero();
    if (!(motion.exposure > 0.0)) return path;
    const Matrix<3> R = exp(0.5 * motion.exposure * motion.rate);
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
std::vector<const Disc*> best_of(const std::vector<Disc>& discs, double apart) {
    std::vector<const Disc*> order, kept;
    for (const Disc& disc : discs)
        if (disc.fit.ok) order.push_back(&disc);
    std::stable_sort(order.begin(), order.end(), [](auto a, auto b) { return a->fit.rim > b->fit.rim; });
    const nb::ssize_t n = nb::ssize_t(order.size());
    Matrix<Dynamic> place(n, 2);
    for (nb::ssize_t i = 0; i < n; i++) place.row(i) = order[size_t(i)]->fit.centroid;
    for (int i : suppress(View<>(place.data(), n, 2), Vector<Dynamic>::Constant(n, apart)))
        kept.push_back(order[size_t(i)]);
    return kept;
}

/// Fit the discs at `directions` to a picture, and move their centroids to their centres.
std::vector<Disc> fit_all(const Photo& photo, const Array<const double, -1, 3>& directions, const double* places,
                          const BallView& view, double min_area, const FitSettings& settings, const Motion& motion,
                          double& size) {
    std::vector<Disc> discs;
    std::vector<Expected> expected;
    for (size_t i = 0; i < directions.shape(0); i++) {
        const Vector<3> direction = at_readout(view, View<3, 1>(&directions(i, 0)), motion);
        const Appearance seen = appearance(view, direction);
        if (!(seen.area >= min_area) || !is_inside(seen, photo.mask)) continue;
        discs.push_back({seen, {}});
        expected.push_back({places ? Vector<2>(View<2, 1>(places + 2 * i)) : seen.centroid, seen.shape,
                            path_of(view, direction, seen.centre, motion)});
    }
    const std::vector<Fit> fits =
        fit_discs(photo, expected, settings, settings.contrast * (places ? 1.0 : EXPECTED), size);
    for (size_t i = 0; i < discs.size(); i++) {
        discs[i].fit = fits[i];
        discs[i].fit.centroid -= discs[i].seen.centroid - discs[i].seen.centre;  // the eccentricity
    }
    return discs;
}

nb::tuple measure_discs(nb::handle image, nb::handle directions_, nb::handle model_, double noise, nb::handle places_,
                        nb::handle motion_, double size) {
    const nb::tuple model = members(model_, 6, "model"), moving = members(motion_, 2, "motion");
    const auto directions = array<const double, -1, 3>(directions_, "directions");
    const auto places = array<const double, -1, 2>(places_, "places");
    if (places.shape(0) != 0 && places.shape(0) != directions.shape(0))
        throw nb::type_error("places: must have the length of directions, or 0");
    const BallView view = read_ball_view(model[0]);
    const FitSettings settings = read_fit_settings(model[3]);
    const Photo photo = read_photo(image, model[1], nb::borrow<nb::tuple>(model[3])[0], noise);
    const Motion motion{vector<3>(moving[0], "rate"), number<double>(moving[1], "motion"),
                        number<double>(model[2], "model")};
    const double min_area = number<double>(model[4], "model"), apart = APART * number<double>(model[5], "model");
    std::vector<Disc> discs;
    {
        nb::gil_scoped_release release;
        discs = fit_all(photo, directions, places.shape(0) ? places.data() : nullptr, view, min_area, settings, motion,
                        size);
    }
    const std::vector<const Disc*> kept = best_of(discs, apart);
    const Rows<2> centre(kept.size());
    const Rows<2, 2> covariance(kept.size());
    auto area = zeros<double>({kept.size()});
    for (size_t i = 0; i < kept.size(); i++) {
        centre[i] = kept[i]->fit.centroid;
        covariance[i] = kept[i]->fit.covariance;
        area.data()[i] = kept[i]->seen.area;
    }
    return nb::make_tuple(centre.array, covariance.array, area, size);
}

}  // namespace

void bind_windows(nb::module_& m) {
    m.def("measure_discs", &measure_discs, arg("image"), arg("directions"), arg("model"), arg("noise"), arg("places"),
          arg("motion"), arg("size"));
}

}  // namespace spheremouse::ball
