// Images of discs on a ball, and their fit to a picture.
#pragma once

#include "spheremouse/ball/ball_view.h"

namespace spheremouse::ball {

using Image = Array<const uint8_t, -1, -1, -1>;  // (h, w, c), three channels of BGR or one
using Mask = Array<const uint8_t, -1, -1>;       // (h, w), not 0 on the ball
using Shape = Matrix<2>;                         // px², (x - centroid)' shape^-1 (x - centroid) = 1 on the rim
using Directions = View<Dynamic, 3>;             // (n, 3) unit vectors, obj

/// Image of a disc (`appearance.Appearance`). All are nan unless the whole rim faces the camera.
struct Appearance {
    Vector<2> centre, centroid;  // px
    Shape shape;
    double area;  // px²
    bool whole;
};

Appearance appearance(const BallView& view, const Vector<3>& direction);

/// Return the pixel of the ball's point in a direction, of the far side too; nan behind the camera.
Vector<2> seen_at(const BallView& view, const Vector<3>& direction);

/// A picture, and a linear projection of its colours in which discs are darker than the ball.
struct Photo {
    Image image;
    Mask mask;
    float weights[3];  // of each channel; of a picture with one channel the first counts
    double noise;      // standard deviation of a projected pixel
};

Photo read_photo(nb::handle image, nb::handle mask, nb::handle projection, double noise);

/// `windows.FitSettings` without the projection.
struct FitSettings {
    double smoothing, blur, contrast, size_tolerance, rim, sigma;
};

FitSettings read_fit_settings(nb::handle settings);

/// `windows.DiscModel` without mask and projection.
struct DiscModel {
    BallView view;
    double exposure;  // s
    FitSettings fit;
    double min_area, diameter;  // px², px
};

/// Read a `windows.DiscModel`, and a picture of its size.
std::pair<DiscModel, Photo> read_model(nb::handle model, nb::handle image, double noise);

/// Motion of the ball during a frame, `windows.Motion`.
struct Motion {
    Vector<3> rate = Vector<3>::Zero();  // rad/s, obj
    double readout = 0.0;                // s, of all rows
    double interval = 0.0;               // s since the same discs were measured before
};

Motion read_motion(nb::handle motion);

constexpr double SMEARED = 2.0;  // px, way of a disc during the exposure

/// A disc's image to be fitted.
struct Expected {
    Vector<2> place;  // px, where the fit begins
    Shape shape;
    Vector<7> path;  // motion during the exposure: way, half of its curvature, px; change of shape^-1, px^-2

    /// Return whether the way is so long that it lightens a part of the disc as a cover does.
    bool is_smeared() const { return path.head<2>().norm() > SMEARED; }
};

/// The result of a fit; without `ok` the numbers are meaningless.
struct Fit {
    Vector<2> centroid = Vector<2>::Zero();    // px
    Matrix<2> covariance = Matrix<2>::Zero();  // px²
    Matrix<2> by_cover = Matrix<2>::Zero();    // px², the part that a cover causes, alike until it or the disc moves
    double rim = 0.0;                          // part of the rim on the ball that fits
    bool ok = false;
};

/// What all discs have in common.
struct Common {
    double size;      // fitted over expected, or 0
    double contrast;  // usual one over the light of the lighter of disc and ball, or 0
};

/// Fit discs to a picture. `contrast` is the least one over the light of the lighter of disc and ball.
///
/// The first fit leaves the size free. It separates discs from other objects and gives the common size of all discs,
/// fitted over expected. The second fit holds the size near that value. Otherwise a disc cut by a strut would look
/// smaller instead of cut. If fewer than three discs determine the size, it is held near 1. If `common.size` is not 0,
/// the first fit is left out, and what has another size is no disc. Clear discs, large and without a cover, move what
/// they have in `common`.
std::vector<Fit> fit_discs(const Photo& photo, const std::vector<Expected>& discs, const FitSettings& settings,
                           double contrast, Common& common);

/// A disc in a picture.
struct Measured {
    Vector<2> centre;      // px
    Matrix<2> covariance;  // px²
    double area;           // px²
};

/// Measure the discs expected at `directions`, as `windows.py` describes it, the best ones first.
std::vector<Measured> measure(const Photo& photo, const Directions& directions, const DiscModel& model,
                              const Motion& motion, Common& common);

/// Measure the discs at dark spots of a ball at rest, the best ones first. `common` has their usual size and contrast.
std::vector<Measured> measure_places(const Photo& photo, const std::vector<Vector<2>>& places, const DiscModel& model,
                                     Common common);

/// Return the columns of `detections.Detections`, and `more`.
template <class... T>
nb::tuple to_numpy(const std::vector<Measured>& found, const T&... more) {
    const Rows<2> centre(found.size());
    const Rows<2, 2> covariance(found.size());
    auto area = zeros<double>({found.size()});
    for (size_t i = 0; i < found.size(); i++) {
        centre[i] = found[i].centre;
        covariance[i] = found[i].covariance;
        area.data()[i] = found[i].area;
    }
    return nb::make_tuple(centre.array, covariance.array, area, more...);
}

}  // namespace spheremouse::ball
