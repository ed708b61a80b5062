// Pixels around a disc, and the image that the fit expects: a sloped background less a blurred ellipse.
#pragma once

#include <memory>
#include <tuple>

#include "spheremouse/ball/detect/disc_model.h"

namespace spheremouse::ball {

constexpr int UNKNOWNS = 9;      // level and slopes of the background, those of the contrast, centre, size
constexpr int EDGE = 3;          // px around a patch that the smoothing needs
constexpr float CLEAR = 0.02f;   // part of a disc's darkness below which a pixel lies beside it
constexpr float COVERED = 0.3f;  // weight below which a pixel shows something else
constexpr float BESIDE = 0.2f;   // of the contrast: what is beside a disc and differs more from the ball is foreign
constexpr float INSIDE = 0.9f;   // part of the greatest darkness from which a pixel lies inside the disc
constexpr size_t LANES = 8;      // partial sums, one for each lane of a wide register

/// Pixels relative to the place of a disc, and the model's value e there, with its derivatives by centre and size.
///
/// Distant pixels of weight 0 fill the last lanes.
struct Pixels {
    size_t count = 0, size = 0;  // without and with those that fill the last lanes
    float *x, *y, *grey, *weight, *e, *d[3];

    /// Make room for that many pixels. All columns share one block of memory, without zeros.
    void reserve(size_t pixels);

    /// Keep that many pixels, and fill the last lanes.
    void resize(size_t pixels);

    /// Exchange two pixels.
    void exchange(size_t i, size_t j);

    /// Keep that many of the first pixels until `restore`.
    void keep(size_t pixels);

    /// Take all pixels again. Those that `keep` left out have no value of the model.
    void restore();

  private:
    std::unique_ptr<float[]> memory_;
    size_t all_ = 0;                                    // pixels
    std::tuple<float, float, float> last_[LANES] = {};  // x, y and grey that the last lanes hide

    void fill();
};

/// An ellipse, (x - c)' inverse (x - c) = size².
struct Ellipse {
    float xx, xy, yy;  // inverse, px^-2
    float x, y;        // px
    float size;
};

/// Return a window of h x w px of a smoothed projection, which the next call of the thread overwrites.
///
/// The picture's last rows and columns repeat beyond its edge.
const float* cut_patch(const Photo& photo, double smoothing, int top, int left, int h, int w);

/// Compute e and its derivatives for a disc that moves along `path` (`Expected`) while the shutter is open.
void expect(Pixels& p, const Ellipse& rest, const Vector<7>& path, float blur);

/// Return the normal matrix N and the gradient g, as the last column.
Matrix<UNKNOWNS, UNKNOWNS + 1> normal_equations(const Pixels& p, const Vector<UNKNOWNS>& x);

/// Compute Tukey's weights: 0 beyond `limit` of the contrast. The bound beside the disc is lower.
void biweight(Pixels& p, const Vector<UNKNOWNS>& x, float limit, float scale);

/// Fit level and slopes x[:3] of the ball beside the disc, three times, the last two without outliers.
void fit_background(Pixels& p, Vector<UNKNOWNS>& x, float noise);

/// Return the contrast to the background x[:3].
double contrast_of(const Pixels& p, const Vector<UNKNOWNS>& x);

/// Set weight 0 beside the disc for pixels that differ by more than `foreign` from the background, else 1.
void leave_out_foreign(Pixels& p, const Vector<UNKNOWNS>& x, float foreign);

/// Grey values around a disc, and inside of it. Those of pixels at its rim are extrapolated to the darkest part.
struct Shades {
    float most;             // greatest part of the disc's darkness in a pixel
    float ball;             // mean beside the disc
    float least, greatest;  // inside

    bool is_inside(float e) const { return e > INSIDE * most; }
    float value(float grey, float e) const { return ball + (grey - ball) * most / e; }
};

Shades shades(const Pixels& p);

/// Leave out the pixels behind the straight edge of a cover, if one cuts the disc. Return the part of the rim that
/// stays visible.
///
/// Two shades inside of the disc show a cover, if a line separates them. `shape` is the disc's, as in `Expected`.
double leave_out_covered(Pixels& p, const Shape& shape);

/// Measures of how well a disc fits.
struct Quality {
    double fits, lost;       // parts of the rim that fit, and that do not at all
    double inside;           // px² of the disc
    double squares, weight;  // sums of the residuals
};

Quality quality(const Pixels& p, const Vector<UNKNOWNS>& x);

}  // namespace spheremouse::ball
