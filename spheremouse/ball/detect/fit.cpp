// Fit of the expected ellipses to a picture: centres of discs, their covariances, and tests of a disc.
//
// The model of the picture around each place is a sloped background minus a blurred ellipse. The geometry gives its
// shape:
//
//     I = b0 + b1 x + b2 y - (a0 + a1 x + a2 y) e(x - c; s)
//
// with the background b, the contrast a, the centre c and the size s, fitted by Gauss-Newton. The contrast has a slope
// because gloss lightens print on one side. A disc that moves during the exposure is the mean of its ellipses along its
// path. Pixels that fit neither (a strut, a highlight) are weighted down (Tukey's biweight). The covariance is that of
// the adjustment (Wittich 2017, chapter 5, names it as the next step).
#include "spheremouse/ball/detect/pixels.h"

namespace spheremouse::ball {
namespace {

constexpr double UNEVEN = 0.02;        // of the contrast: unevenness of print and ball that a good fit leaves
constexpr double GLOSS = 0.3;          // of the contrast, the most that gloss takes of it, from a centre to its rim
constexpr double SLOPE = 0.02;         // 1/px of the ball's shade, as 60 degrees off the light at 100 px radius
constexpr double SIZE = 0.02;          // discs cut from one sheet differ by this part of their size
// Of a picture in focus. Lengths grow with the blur, biases of slivers with its cube and square.
constexpr double IN_FOCUS = 0.94;      // px, blur of its rims
constexpr double SURROUND = 3.0;       // px of background around a disc: enough for its slope, too few for more
constexpr double RIM_OFFSET = 0.35;    // px, three standard deviations of a rim's shift by blur and gloss
constexpr double SLIVER = 2.0;         // px, semi-minor axis below which both rims are one blur
constexpr double SLIVER_BIAS = 0.15;   // px at a semi-minor axis of one pixel
constexpr double SLIVER_SIZE = 0.18;   // part of its size by which that blur shortens it there
constexpr double COVER_BIAS = 1.5;     // px, the same of a disc that a cover cuts, along its shorter axis
constexpr double MISFIT = 16.0;        // px²: error times semi-minor axis, per part of the rim that does not fit
constexpr double SHOWN = 0.15;         // least part of the rim beside a cover: an arc of 54 degrees
constexpr double OTHER_SIZE = 3.0;     // standard deviations of the size, beyond which it is something else
constexpr double NEAR_COVER = 0.02;    // part of the surround that is foreign: a cover is beside the disc
constexpr double CLEAR_SIGMA = 0.1;    // px, of a disc without a cover
constexpr double LEARNING_RATE = 0.1;  // per frame: the light changes in a third of a second at the fastest
constexpr double LARGE = 3.0;          // px, semi-minor axis from which a disc contributes to the common size
constexpr float LIMIT = 0.25f;         // of the contrast: residuals beyond weigh nothing
constexpr float WIDE_LIMIT = 0.5f;     // the same far from the centre
constexpr double FAR = 0.5;            // px: after a longer step the centre is still far
constexpr int MOST_ROUNDS = 10;        // 1 px each at most
constexpr int SMEARED_ROUNDS = 5;      // of a disc with a long way: the way is wrong if it needs more
constexpr double STILL = 0.01;         // px: a step this short is the last

using Unknowns = Vector<UNKNOWNS>;

/// Expected ranges of the unknowns, as observations with these standard deviations.
struct Expectation {
    double gloss;             // 1/px of the contrast, of its slope
    double size, size_sigma;  // of all discs
};

struct DiscFit {
    Expected disc;
    Ellipse rest;
    double minor, major;  // px, semi-axes
    double defocus;       // blur of rims over that of a picture in focus
    Pixels pixels;
    Unknowns x = Unknowns::Zero();
    double scale;        // grey values of an ordinary residual
    double gloss;        // 1/px
    double shown = 1.0;  // part of the rim that no cover hides
    Matrix<UNKNOWNS> L;  // triangle of the last normal matrix
    bool plausible = false;

    bool is_smeared() const { return disc.is_smeared(); }

    /// Return the standard deviation of the rim's shift by blur and gloss, relative to the size.
    double rim_sigma() const { return RIM_OFFSET / 3.0 * defocus / minor; }

    /// Return the square of defocus over semi-minor axis, px^-2, to which the biases of slivers are proportional.
    double thinness() const { return std::pow(defocus / minor, 2); }

    double size_sigma() const { return SIZE + rim_sigma(); }

    void expect(float blur) {
        rest.x = float(x(6));
        rest.y = float(x(7));
        rest.size = float(x(8));
        ball::expect(pixels, rest, disc.path, blur);
    }
};

/// Return the light of the lighter of ball and disc.
double lighter(const Unknowns& x) { return std::max(std::abs(x(0)), std::abs(x(0) - x(3))); }

/// Return true if the contrast exceeds this part of the lighter of disc and ball, and the noise.
bool is_deep(const Unknowns& x, double contrast, double noise) {
    const double ball = x(0) + x(1) * x(6) + x(2) * x(7);
    return x(3) > std::max(contrast * std::max(std::abs(ball), std::abs(ball - x(3))), 4.0 * noise);
}

/// Return the solution of L L' x = b.
template <int N>
Vector<N> solve(const Matrix<N>& L, Vector<N> b) {
    for (int i = 0; i < N; i++) {
        b(i) = L(i, i) == 0.0 ? 0.0 : b(i) / L(i, i);
        for (int k = i + 1; k < N; k++) b(k) -= L(k, i) * b(i);
    }
    for (int i = N - 1; i >= 0; i--) {
        b(i) = L(i, i) == 0.0 ? 0.0 : b(i) / L(i, i);
        for (int k = 0; k < i; k++) b(k) -= L(i, k) * b(i);
    }
    return b;
}

/// Take one Gauss-Newton step times `damping`, and return the length of the centre's full step, px.
///
/// Without damping, changing weights make the steps oscillate. Three expectations enter as observations:
/// - A ball's shade slopes little. A steeper slope belongs to a strut.
/// - Print leaves a part of the light, so the contrast slopes as the shade of a light ball does. A dark ball's shade
///   gives no information about it. Gloss changes that slope.
/// - The size. In the image of a sliver, size and contrast are inseparable, so this value decides.
double gauss_newton_step(DiscFit& fit, const Expectation& expected, double damping) {
    Unknowns& x = fit.x;
    const Matrix<UNKNOWNS, UNKNOWNS + 1> Ng = normal_equations(fit.pixels, x);
    Matrix<UNKNOWNS> N = Ng.leftCols<UNKNOWNS>();
    Unknowns g = Ng.col(UNKNOWNS);
    const double shade = std::pow(fit.scale / (SLOPE * std::max(std::abs(x(0)), 1.0)), 2);
    const double gleam = std::pow(fit.scale / (expected.gloss * std::max(x(3), 1.0)), 2);
    const double hold = std::pow(fit.scale / expected.size_sigma, 2);
    const double as_shade = x(3) * x(0) / std::pow(std::max(lighter(x), 1.0), 2);
    for (int k = 1; k < 3; k++) {
        const double difference = x(k + 3) - as_shade * x(k);
        N(k, k) += shade + gleam * as_shade * as_shade;
        N(k, k + 3) -= gleam * as_shade;
        N(k + 3, k) -= gleam * as_shade;
        N(k + 3, k + 3) += gleam;
        g(k) -= shade * x(k) - gleam * as_shade * difference;
        g(k + 3) -= gleam * difference;
    }
    N(8, 8) += hold;
    g(8) -= hold * (x(8) - expected.size);
    N.diagonal().array() += 1e-6;
    fit.L = lower(N);
    Unknowns step = solve<UNKNOWNS>(fit.L, g);
    step(6) = std::clamp(step(6), -1.0, 1.0);
    step(7) = std::clamp(step(7), -1.0, 1.0);
    step(8) = std::clamp(step(8), -0.2, 0.2);
    x += damping * step;
    x(8) = std::clamp(x(8), 0.3, 2.5);
    return std::max(std::abs(step(6)), std::abs(step(7)));
}

/// Collect the pixels on the ball within an ellipse whose axes are longer by SURROUND times the defocus and half of the
/// way. Set axes, defocus and shape at rest; return false if there are too few pixels.
bool collect_pixels(DiscFit& fit, const Photo& photo, const FitSettings& settings) {
    const Shape& S = fit.disc.shape;
    const double u0 = fit.disc.place(0), v0 = fit.disc.place(1);
    fit.defocus = settings.blur / IN_FOCUS;
    const double det = S.determinant(), mean = 0.5 * S.trace(), half = std::hypot(0.5 * (S(0, 0) - S(1, 1)), S(0, 1));
    if (!(det > 1e-3 && std::isfinite(u0 + v0) && fit.disc.path.allFinite())) return false;
    fit.minor = std::sqrt(std::max(mean - half, 1e-6));
    fit.major = std::sqrt(std::max(mean + half, 1e-6));
    fit.rest = {float(S(1, 1) / det), float(-S(0, 1) / det), float(S(0, 0) / det), 0.0f, 0.0f, 1.0f};
    // of the same axes, so a combination of S and I
    const double lo = fit.minor * fit.minor, hi = fit.major * fit.major;
    const double margin = SURROUND * fit.defocus + 0.5 * fit.disc.path.head<2>().norm();
    const double low = std::pow(fit.minor + margin, 2), high = std::pow(fit.major + margin, 2);
    const double slope = hi - lo > 1e-9 * hi ? (high - low) / (hi - lo) : 1.0;
    const Shape G = slope * S + (low - slope * lo) * Shape::Identity();
    const double bound = G.determinant(), half_w = std::ceil(std::sqrt(G(0, 0))),
                 half_h = std::ceil(std::sqrt(G(1, 1)));
    const int width = int(photo.mask.shape(1)), height = int(photo.mask.shape(0));
    if (!(half_w <= width && half_h <= height && std::abs(u0) <= 2.0 * width && std::abs(v0) <= 2.0 * height))
        return false;
    const int left = int(std::rint(u0) - half_w), top = int(std::rint(v0) - half_h), w = 2 * int(half_w) + 1,
              h = 2 * int(half_h) + 1;
    const float* patch = cut_patch(photo, settings.smoothing, top, left, h, w);
    Pixels& pixels = fit.pixels;
    pixels.reserve(size_t(h * w));
    size_t count = 0;
    for (int i = std::max(-top, 0); i < std::min(h, height - top); i++) {
        const double dy = top + i - v0, chord = bound * (G(1, 1) - dy * dy);
        if (!(chord > 0.0)) continue;
        const double middle = u0 - left + G(0, 1) * dy / G(1, 1), half_chord = std::sqrt(chord) / G(1, 1);
        const int end = std::min(int(middle + half_chord) + 1, std::min(w, width - left));
        for (int j = std::max(int(middle - half_chord + 1.0), std::max(-left, 0)); j < end; j++) {
            pixels.x[count] = float(left + j - u0);
            pixels.y[count] = float(dy);
            pixels.grey[count] = patch[i * w + j];
            count += photo.mask(size_t(top + i), size_t(left + j)) != 0;
        }
    }
    if (count < 2 * UNKNOWNS) return false;
    pixels.resize(count);
    return true;
}

/// Leave out what lies behind a cover; return false if that is too much of the disc.
bool leave_out_cover(DiscFit& fit) {
    fit.shown = fit.is_smeared() ? 1.0 : leave_out_covered(fit.pixels, fit.disc.shape);
    return fit.shown > SHOWN;
}

/// Estimate background and contrast, first the ball's shade beside the disc; return false if there is no disc.
bool estimate_light(DiscFit& fit, const Photo& photo, const FitSettings& settings, double contrast) {
    Pixels& pixels = fit.pixels;
    if (std::count_if(pixels.e, pixels.e + pixels.count, [](float e) { return e < CLEAR; }) < UNKNOWNS) return false;
    fit_background(pixels, fit.x, float(photo.noise));
    const double a = contrast_of(pixels, fit.x);
    fit.x.segment<3>(3) << a, 0.0, 0.0;
    if (!(a >= std::max(0.3 * contrast * lighter(fit.x), 2.0 * photo.noise))) return false;
    fit.scale = std::max(photo.noise, UNEVEN * a);
    // across a sliver a slope of the contrast and a shift of the centre look alike: there gloss is left out
    fit.gloss = std::clamp((fit.minor - 2.0 * settings.blur) / 1.5, 0.01, 1.0) / fit.major;
    leave_out_foreign(pixels, fit.x, float(BESIDE * a + 4.0 * photo.noise));
    return true;
}

/// Begin a fit at the expected place; return false if there is no disc.
bool begin(DiscFit& fit, const Photo& photo, const FitSettings& settings, double contrast) {
    if (!collect_pixels(fit, photo, settings)) return false;
    fit.x(8) = 1.0;
    fit.expect(float(settings.blur));
    return leave_out_cover(fit) && estimate_light(fit, photo, settings, contrast);
}

/// Fit the size, too; return false if the result is no disc.
bool fit_size(DiscFit& fit, const Photo& photo, const FitSettings& settings, double contrast) {
    const double tolerance = settings.size_tolerance;
    for (int round = 0; round < 2; round++) {
        if (round > 0) biweight(fit.pixels, fit.x, 0.5f, float(fit.scale));
        gauss_newton_step(fit, {GLOSS * fit.gloss, 1.0, 0.4 * tolerance}, 1.0);
        fit.expect(float(settings.blur));
        if (round == 0 && (!is_deep(fit.x, 0.5 * contrast, photo.noise) || std::abs(fit.x(8) - 1.0) > 2.0 * tolerance))
            return false;
    }
    return std::abs(fit.x(8) - 1.0) < std::max(tolerance, 3.0 * fit.rim_sigma()) &&
           is_deep(fit.x, contrast, photo.noise);
}

/// Return the median size of large discs, or 0 of fewer than three.
double common_size(const std::vector<DiscFit>& fits) {
    std::vector<double> sizes;
    for (const DiscFit& fit : fits)
        if (fit.plausible && fit.minor > LARGE) sizes.push_back(fit.x(8));
    if (sizes.size() < 3) return 0.0;
    std::sort(sizes.begin(), sizes.end());
    return 0.5 * (sizes[(sizes.size() - 1) / 2] + sizes[sizes.size() / 2]);
}

/// Return the contrast over light of discs without gloss: the largest measured; 1 with fewer than three discs.
///
/// Gloss reduces the contrast. A slope due to gloss is at most as steep as that reduction.
double full_contrast(const std::vector<DiscFit>& fits) {
    double full = 0.0;
    int count = 0;
    for (const DiscFit& fit : fits)
        if (fit.plausible && fit.minor > LARGE) {
            full = std::max(full, fit.x(3) / lighter(fit.x));
            count++;
        }
    return count >= 3 ? full : 1.0;
}

/// Move a usual value towards the median one of a frame's clear discs, or set it if it is 0.
void learn(std::vector<double>& values, double& usual) {
    std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
    usual += (usual > 0.0 ? LEARNING_RATE : 1.0) * (values[values.size() / 2] - usual);
}

/// Learn size and contrast from the clear discs of a frame.
void learn_common(const std::vector<DiscFit>& fits, const std::vector<Fit>& results, Common& common) {
    std::vector<double> sizes, contrasts;
    for (size_t i = 0; i < fits.size(); i++)
        if (results[i].ok && fits[i].minor > LARGE && results[i].covariance.trace() < 2.0 * CLEAR_SIGMA * CLEAR_SIGMA) {
            sizes.push_back(fits[i].x(8));
            contrasts.push_back(fits[i].x(3) / lighter(fits[i].x));
        }
    if (sizes.empty()) return;
    learn(sizes, common.size);
    learn(contrasts, common.contrast);
}

/// Return the part of a disc's surround that is not the ball.
double foreign_beside(const Pixels& pixels) {
    int clear = 0, foreign = 0;
    for (size_t i = 0; i < pixels.count; i++) {
        clear += pixels.e[i] < CLEAR;
        foreign += pixels.e[i] < CLEAR && pixels.weight[i] < COVERED;
    }
    return double(foreign) / std::max(clear, 1);
}

/// Fit the centre with a known size, and return the centre's last step, px.
double fit_known_size(DiscFit& fit, const FitSettings& settings, double size, double full) {
    const Unknowns& x = fit.x;
    double moved = 1.0;
    for (int round = 0; round < (fit.is_smeared() ? SMEARED_ROUNDS : MOST_ROUNDS) && !(round > 1 && moved < STILL);
         round++) {
        biweight(fit.pixels, x, moved > FAR && !fit.is_smeared() ? WIDE_LIMIT : LIMIT, float(fit.scale));
        const double gloss = fit.gloss * std::min(std::max(1.0 - x(3) / lighter(x) / full, UNEVEN), GLOSS);
        moved = gauss_newton_step(fit, {gloss, size, fit.size_sigma()}, round < 2 ? 1.0 : 0.5);
        fit.expect(float(settings.blur));
    }
    return moved;
}

/// Set the covariance of the centre, px², without the systematic part of all discs.
void set_covariance(Fit& result, const DiscFit& fit, const Quality& q, double noise, double size) {
    // of the pixels' noise the smoothing leaves about a half in a centre
    const double variance = std::max(q.squares / std::max(q.weight - UNKNOWNS, 1.0), 0.5 * noise * noise);
    Matrix<3> C;  // of centre and size; they are the last unknowns, so the others do not matter
    for (int j = 0; j < 3; j++) C.row(j) = solve<3>(fit.L.bottomRightCorner<3, 3>(), Vector<3>::Unit(j));
    // where both rims are one blur the limb's own shade draws the centre: from experience with rendered limbs
    const double thin = fit.thinness(), sliver = SLIVER_BIAS * fit.defocus * thin;
    const double cover = COVER_BIAS / std::pow(fit.minor, 3);
    // what shifts a rim changes the size of a whole disc, and moves the centre of one with a rim on one side only,
    // alike in each view
    const Vector<2> moved = C.topRightCorner<2, 1>() / C(2, 2) * fit.rim_sigma();
    const Matrix<2> by_rim = moved * moved.transpose();
    result.covariance = variance * C.topLeftCorner<2, 2>() + sliver * sliver * Matrix<2>::Identity();
    if (fit.shown < 1.0) {
        result.by_cover = cover * cover * fit.disc.shape + by_rim;
        return;
    }
    result.covariance += by_rim;
    // Gloss fits as badly as a cover, with nothing foreign beside it. Of whole discs one in twenty fits worse. A part
    // of the rim that does not fit shifts the centre in proportion to it, and a large disc less: from rendered covers.
    const double near = std::min(foreign_beside(fit.pixels) / NEAR_COVER, 1.0);
    const double unfit = std::max(q.lost, near * (0.95 - 0.1 / fit.minor - q.fits));
    const double misfit = std::pow(MISFIT * unfit / std::max(fit.minor, LARGE), 2);
    // An edge beside the disc that is not recognised as one of a cover passes for a rim: it shifts the size as much as
    // the centre. A thin disc with a hidden end fits well, so only its size shows that.
    if (fit.minor < LARGE) {
        const double other = std::max(std::abs(fit.x(8) - size + SLIVER_SIZE * thin) - SIZE * (1.0 + thin), 0.0);
        result.by_cover = misfit * Matrix<2>::Identity() + other * other * fit.disc.shape;
    } else {
        const double other = std::max(std::abs(fit.x(8) - size) - fit.size_sigma(), 0.0) * fit.minor;
        result.by_cover = (misfit + near * other * other) * Matrix<2>::Identity();
    }
}

/// Return the part of a circle's area that a chord leaves with a part of its rim.
double segment(double rim) { return rim - std::sin(2.0 * M_PI * rim) / (2.0 * M_PI); }

/// Fit a disc of known size.
///
/// The fitted place shows better than the expected one whether a cover hides a part of the disc.
Fit fit_centre(DiscFit& fit, const Photo& photo, const FitSettings& settings, double contrast, double size,
               double full) {
    const Unknowns& x = fit.x;
    double moved = fit_known_size(fit, settings, size, full);
    const bool was_covered = fit.shown < 1.0;
    Vector<2> corrected = Vector<2>::Zero();
    if (was_covered) {
        fit.pixels.restore();
        fit.expect(float(settings.blur));
    }
    if (!leave_out_cover(fit)) return {};
    if (was_covered || fit.shown < 1.0) {
        corrected = x.segment<2>(6);
        if (!estimate_light(fit, photo, settings, contrast)) return {};
        moved = fit_known_size(fit, settings, size, full);
        corrected -= x.segment<2>(6);
    }
    const Quality q = quality(fit.pixels, x);
    // the far rim of a sliver drowns in the limb; half of it, with the known size, still fixes the centre
    const double rim = fit.minor < SLIVER * fit.defocus ? std::min(0.45, settings.rim) : settings.rim;
    // what a cover hides is left out, so nothing excuses a misfit of the rest: the less shows, the better it must fit
    const double least = 1.0 - (1.0 - rim) * fit.shown;
    const double area = M_PI * std::sqrt(fit.disc.shape.determinant()) * size * size;
    Fit result;
    result.ok = is_deep(x, contrast, photo.noise) && q.fits > least && q.inside > 0.4 * area * segment(fit.shown) &&
                moved < 0.1;
    result.rim = q.fits * fit.shown;
    result.centroid = fit.disc.place + x.segment<2>(6);
    set_covariance(result, fit, q, photo.noise, size);
    result.by_cover += corrected.squaredNorm() * Matrix<2>::Identity();
    result.covariance += result.by_cover + settings.sigma * settings.sigma * Matrix<2>::Identity();
    return result;
}

nb::tuple fit_discs_(nb::handle image, nb::handle mask, nb::handle expected_, double noise, nb::handle settings_,
                     double contrast, double size) {
    const nb::tuple expected = members(expected_, 3, "expected");
    const auto place = array<const double, -1, 2>(expected[0], "place");
    const auto shape = array<const double, -1, 2, 2>(expected[1], "shape");
    const auto path = array<const double, -1, 7>(expected[2], "path");
    const size_t n = place.shape(0);
    if (shape.shape(0) != n || path.shape(0) != n) throw nb::type_error("shape, path: must have the length of place");
    const Photo photo = read_photo(image, mask, members(settings_, 7, "settings")[0], noise);
    const FitSettings settings = read_fit_settings(settings_);
    std::vector<Expected> discs(n);
    for (size_t i = 0; i < n; i++)
        discs[i] = {View<2, 1>(&place(i, 0)), View<2, 2>(&shape(i, 0, 0)), View<7, 1>(&path(i, 0))};
    std::vector<Fit> fits;
    Common common{size, 0.0};
    {
        nb::gil_scoped_release release;
        fits = fit_discs(photo, discs, settings, contrast, common);
    }
    auto ok = zeros<bool>({n});
    auto centroid = zeros<double>({n, 2}), covariance = zeros<double>({n, 2, 2}), rim = zeros<double>({n});
    for (size_t i = 0; i < n; i++) {
        static_cast<bool*>(ok.data())[i] = fits[i].ok;
        Eigen::Map<Vector<2>>(centroid.data() + 2 * i) = fits[i].centroid;
        Eigen::Map<Matrix<2>>(covariance.data() + 4 * i) = fits[i].covariance;
        rim.data()[i] = fits[i].rim;
    }
    return nb::make_tuple(ok, centroid, covariance, rim, common.size);
}

}  // namespace

std::vector<Fit> fit_discs(const Photo& photo, const std::vector<Expected>& discs, const FitSettings& settings,
                           double contrast, Common& common) {
    double size = common.size;
    std::vector<DiscFit> fits(discs.size());
    for (size_t i = 0; i < discs.size(); i++) {
        fits[i].disc = discs[i];
        fits[i].plausible = begin(fits[i], photo, settings, contrast);
        if (fits[i].plausible && size > 0.0)
            fits[i].x(8) = size;
        else if (fits[i].plausible)
            fits[i].plausible = fit_size(fits[i], photo, settings, contrast);
    }
    if (!(size > 0.0)) size = common_size(fits);
    const double full = full_contrast(fits);
    std::vector<Fit> results(discs.size());
    for (size_t i = 0; i < discs.size(); i++)
        if (fits[i].plausible)
            results[i] = fit_centre(fits[i], photo, settings, contrast, size > 0.0 ? size : 1.0, full);
    learn_common(fits, results, common);
    for (size_t i = 0; i < discs.size() && common.size > 0.0; i++)
        results[i].ok &= std::abs(fits[i].x(8) - common.size) < OTHER_SIZE * fits[i].size_sigma();
    return results;
}

void bind_fit(nb::module_& m) {
    m.def("fit_discs", &fit_discs_, arg("image"), arg("mask"), arg("expected"), arg("noise"), arg("settings"),
          arg("contrast"), arg("size"));
}

}  // namespace spheremouse::ball
