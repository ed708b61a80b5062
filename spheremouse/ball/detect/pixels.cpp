#include "spheremouse/ball/detect/pixels.h"

#include <cstring>
#include <tuple>
#include <utility>

namespace spheremouse::ball {
namespace {

constexpr float FILL = 1e6f;         // grey value of the pixels that fill the last lanes
constexpr double RIPPLE_STEP = 1.8;  // of the blur, px between the images of a smear: its ripple is below 1 %

#pragma GCC diagnostic ignored "-Wpsabi"  // all functions of lanes are inlined
#define INLINE [[gnu::always_inline]] inline

/// Consecutive pixels of a column. Each has its own partial sum, so wide registers give the same results.
typedef float Lanes __attribute__((vector_size(LANES * sizeof(float))));

INLINE Lanes lanes(const float* column, size_t i) {
    Lanes v;
    std::memcpy(&v, column + i, sizeof(v));
    return v;
}

INLINE void put(const Lanes& v, float* column, size_t i) { std::memcpy(column + i, &v, sizeof(v)); }

INLINE Lanes root(const Lanes& v) {
    Lanes r = v;
    for (size_t l = 0; l < LANES; l++) r[l] = std::sqrt(v[l]);
    return r;
}

INLINE Lanes absolute(const Lanes& v) { return v < 0.0f ? -v : v; }

INLINE float total(const Lanes& s) { return ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7])); }

/// Background and contrast, sloped: I = b0 + b1 x + b2 y - (a0 + a1 x + a2 y) e.
struct Light {
    float b0, b1, b2, a0, a1, a2;

    explicit Light(const Vector<UNKNOWNS>& x)
        : b0(float(x(0))), b1(float(x(1))), b2(float(x(2))), a0(float(x(3))), a1(float(x(4))), a2(float(x(5))) {}

    template <class T>
    INLINE T background(const T& x, const T& y) const {
        return b0 + b1 * x + b2 * y;
    }
    template <class T>
    INLINE T contrast(const T& x, const T& y) const {
        return a0 + a1 * x + a2 * y;
    }
    INLINE Lanes off_background(const Pixels& p, size_t i) const {
        return lanes(p.grey, i) - background(lanes(p.x, i), lanes(p.y, i));
    }
    INLINE Lanes residual(const Pixels& p, size_t i) const {
        return off_background(p, i) + contrast(lanes(p.x, i), lanes(p.y, i)) * lanes(p.e, i);
    }
};

/// The Gaussian distribution function of sqrt(2) x, x >= 0, less a half, and its derivative by x.
///
/// Abramowitz and Stegun 1964, 7.1.27: within 3e-4, the derivative that of the approximation.
struct Phi {
    Lanes p, dp;

    INLINE explicit Phi(const Lanes& x)
        : p(1.0f + x * (0.278393f + x * (0.230389f + x * (0.000972f + x * 0.078108f)))),
          dp(0.278393f + x * (0.460778f + x * (0.002916f + x * 0.312432f))) {}

    /// Return the function, and the derivative in `bell`; `inverse` is 1 / p.
    INLINE Lanes value(const Lanes& inverse, Lanes& bell) const {
        const Lanes square = inverse * inverse, tail = 0.5f * square * square;
        bell = 4.0f * tail * inverse * dp;
        return 0.5f - tail;
    }
};

/// Add a share of the image of an ellipse to e and its derivatives; the `first` one replaces them.
///
/// With rho² = (x - c)' S^-1 (x - c) the rim lies (s - rho) / |grad rho| ahead and (s + rho) / |grad rho| behind. A
/// strip of that width, blurred, is e = Phi(ahead) + Phi(behind) - 1. A disc that travels by u, v px while the shutter
/// is open is blurred by that too, across its rim: the variance of a box is a twelfth of its square.
WIDE void add_ellipse(const Pixels& p, const Ellipse& s, float u, float v, float blur, float share, bool first) {
    const float square = blur * blur, lx = 0.28867513f * u, ly = 0.28867513f * v;
    for (size_t i = 0; i < p.size; i += LANES) {
        const Lanes dx = lanes(p.x, i) - s.x, dy = lanes(p.y, i) - s.y;
        const Lanes gx = s.xx * dx + s.xy * dy, gy = s.xy * dx + s.yy * dy, along = gx * lx + gy * ly;
        const Lanes rho = root(gx * dx + gy * dy + 1e-6f);
        const Lanes by_size = 0.70710678f / root((gx * gx + gy * gy) * square + along * along + 1e-12f);
        const Lanes steep = rho * by_size, z = (s.size - rho) * steep;
        const Phi to_rim(absolute(z)), to_far_rim((s.size + rho) * steep);
        const Lanes inverse = 1.0f / (to_rim.p * to_far_rim.p);  // one division for both
        Lanes bell_ahead, bell_behind;
        const Lanes ahead = to_rim.value(to_far_rim.p * inverse, bell_ahead),
                    behind = to_far_rim.value(to_rim.p * inverse, bell_behind);
        const Lanes by_rho = share * (bell_ahead - bell_behind) * by_size;  // minus de/drho, over rho
        const Lanes e = share * ((z < 0.0f ? -ahead : ahead) + behind);
        const Lanes d[] = {by_rho * gx, by_rho * gy,
                           share * (bell_ahead + bell_behind) * steep};  // rho falls by g / rho
        put(first ? e : lanes(p.e, i) + e, p.e, i);
        for (int k = 0; k < 3; k++) put(first ? d[k] : lanes(p.d[k], i) + d[k], p.d[k], i);
    }
}

constexpr size_t BLOCK = 16;  // lanes of all columns that the nearest cache holds
using Columns = Lanes[UNKNOWNS + 1][BLOCK];
using Sums = Lanes[UNKNOWNS][UNKNOWNS + 1];

/// Add the weighted products of the columns from J on with those after them: registers hold the sums of one J.
template <int J>
INLINE void add_products(const Columns& A, const float* weight, size_t n, Sums& sums) {
    Lanes row[UNKNOWNS + 1 - J];
    for (int k = J; k <= UNKNOWNS; k++) row[k - J] = sums[J][k];
    for (size_t b = 0; b < n; b++) {
        const Lanes weighted = lanes(weight, b * LANES) * A[J][b];
        for (int k = J; k <= UNKNOWNS; k++) row[k - J] += weighted * A[k][b];
    }
    for (int k = J; k <= UNKNOWNS; k++) sums[J][k] = row[k - J];
    if constexpr (J + 1 < UNKNOWNS) add_products<J + 1>(A, weight, n, sums);
}

/// Project the colours of n pixels.
WIDE void project_colours(const uint8_t* line, int channels, const float* weights, size_t n, float* __restrict out) {
    const float w0 = weights[0], w1 = weights[1], w2 = weights[2];
    if (channels == 3)
        for (size_t j = 0; j < n; j++)
            out[j] = w0 * float(line[3 * j]) + w1 * float(line[3 * j + 1]) + w2 * float(line[3 * j + 2]);
    else
        for (size_t j = 0; j < n; j++) out[j] = w0 * float(line[j]);
}

/// Smooth n values by a symmetric kernel of seven, whose middle has k[0]; their neighbours lie `step` apart.
WIDE void smooth(const float* __restrict in, size_t step, const float* k, size_t n, float* __restrict out) {
    const float k0 = k[0], k1 = k[1], k2 = k[2], k3 = k[3];
    for (size_t j = 0; j < n; j++) {
        const float* r = in + j;
        out[j] = k0 * r[3 * step] + k1 * (r[2 * step] + r[4 * step]) + k2 * (r[step] + r[5 * step]) +
                 k3 * (r[0] + r[6 * step]);
    }
}

/// Set x[:3] to level and slopes of the weighted grey values.
WIDE void fit_plane(const Pixels& p, Vector<UNKNOWNS>& x) {
    Lanes s[9] = {};
    for (size_t i = 0; i < p.size; i += LANES) {
        const Lanes px = lanes(p.x, i), py = lanes(p.y, i), g = lanes(p.grey, i), w = lanes(p.weight, i);
        const Lanes wx = w * px, wy = w * py, terms[9] = {w, wx, wy, w * g, wx * px, wx * py, wy * py, wx * g, wy * g};
        for (int k = 0; k < 9; k++) s[k] += terms[k];
    }
    const double sw = total(s[0]);
    if (sw < 3.0) return;
    const double mx = total(s[1]) / sw, my = total(s[2]) / sw, mg = total(s[3]) / sw;
    const double cxx = total(s[4]) - sw * mx * mx + 1e-3, cxy = total(s[5]) - sw * mx * my,
                 cyy = total(s[6]) - sw * my * my + 1e-3, cxg = total(s[7]) - sw * mx * mg,
                 cyg = total(s[8]) - sw * my * mg;
    const double det = cxx * cyy - cxy * cxy;
    x(1) = (cyy * cxg - cxy * cyg) / det;
    x(2) = (cxx * cyg - cxy * cxg) / det;
    x(0) = mg - x(1) * mx - x(2) * my;
}

/// Set weight 1 for pixels beside the disc within 1.5 mean deviations of the plane x[:3], else 0.
WIDE void keep_near(Pixels& p, const Vector<UNKNOWNS>& x, float noise) {
    const Light light(x);
    Lanes deviations = {}, count = {};
    for (size_t i = 0; i < p.size; i += LANES) {
        deviations += lanes(p.weight, i) * absolute(light.off_background(p, i));
        count += lanes(p.weight, i);
    }
    const float off = std::max(1.5f * total(deviations) / (total(count) + 1e-3f), 2.0f * noise);
    for (size_t i = 0; i < p.size; i += LANES) {
        const auto near = (absolute(light.off_background(p, i)) < off) & (lanes(p.e, i) < CLEAR);
        put(near ? Lanes{} + 1.0f : Lanes{}, p.weight, i);
    }
}

}  // namespace

void Pixels::reserve(size_t pixels) {
    constexpr size_t COLUMNS = 8, BYTES = LANES * sizeof(float);
    const size_t room = (pixels + LANES - 1) / LANES * LANES;
    memory_.reset(new float[COLUMNS * room + LANES]);
    float* column = memory_.get();
    while (reinterpret_cast<uintptr_t>(column) % BYTES != 0) column++;
    for (float** c : {&x, &y, &grey, &weight, &e, &d[0], &d[1], &d[2]}) *c = std::exchange(column, column + room);
}

void Pixels::resize(size_t pixels) {
    count = all_ = pixels;
    fill();
}

void Pixels::fill() {
    size = (count + LANES - 1) / LANES * LANES;
    const float far = 50.0f + 0.25f * float(all_);  // px beyond the disc and its blur
    for (size_t i = count; i < size; i++) {
        x[i] = x[0] + far, y[i] = y[0] + far, grey[i] = FILL;
        for (float* column : {weight, e, d[0], d[1], d[2]}) column[i] = 0.0f;
    }
}

void Pixels::exchange(size_t i, size_t j) {
    for (float* column : {x, y, grey, weight, e, d[0], d[1], d[2]}) std::swap(column[i], column[j]);
}

void Pixels::keep(size_t pixels) {
    count = pixels;
    for (size_t l = 0; l < LANES && count + l < all_; l++) last_[l] = {x[count + l], y[count + l], grey[count + l]};
    fill();
}

void Pixels::restore() {
    for (size_t l = 0; l < LANES && count + l < all_; l++)
        std::tie(x[count + l], y[count + l], grey[count + l]) = last_[l];
    count = all_;
    fill();
}

const float* cut_patch(const Photo& photo, double smoothing, int top, int left, int h, int w) {
    const int height = int(photo.image.shape(0)), width = int(photo.image.shape(1)),
              channels = int(photo.image.shape(2));
    const size_t rows = size_t(h + 2 * EDGE), columns = size_t(w + 2 * EDGE);
    float kernel[EDGE + 1], total = 0.0f;
    for (int k = 0; k <= EDGE; k++) {
        kernel[k] = float(std::exp(-0.5 * std::pow(k / std::max(smoothing, 1e-3), 2)));
        total += k == 0 ? kernel[k] : 2.0f * kernel[k];
    }
    for (float& k : kernel) k /= total;
    thread_local std::vector<float> raw, across, patch;
    thread_local std::vector<uint8_t> edge;
    raw.resize(columns);
    across.resize(rows * size_t(w));
    patch.resize(size_t(h) * size_t(w));
    edge.resize(columns * size_t(channels));
    const int x0 = left - EDGE;
    const int begin = std::clamp(x0, 0, width), end = std::clamp(x0 + int(columns), begin, width);
    for (size_t i = 0; i < rows; i++) {  // all lines come from memory at once, instead of one by one
        const int row = std::clamp(top - EDGE + int(i), 0, height - 1);
        prefetch(&photo.image(size_t(row), 0, 0) + begin * channels, (end - begin) * channels);
    }
    for (size_t i = 0; i < rows; i++) {
        const int row = std::clamp(top - EDGE + int(i), 0, height - 1);
        const uint8_t* line = &photo.image(size_t(row), 0, 0);
        if (x0 >= 0 && x0 + int(columns) <= width)
            line += x0 * channels;
        else {
            for (size_t j = 0; j < columns; j++)
                std::copy_n(line + std::clamp(x0 + int(j), 0, width - 1) * channels, channels,
                            &edge[j * size_t(channels)]);
            line = edge.data();
        }
        project_colours(line, channels, photo.weights, columns, raw.data());
        smooth(raw.data(), 1, kernel, size_t(w), &across[i * size_t(w)]);
    }
    smooth(across.data(), size_t(w), kernel, patch.size(), patch.data());
    return patch.data();
}

/// At time t, from -1/2 to 1/2 of the exposure, the centre is c + t s + t² q. The curvature q matters: seen in
/// perspective, a turning ball's discs travel along arcs at a changing speed. Foreshortening changes the shape. The
/// images are RIPPLE_STEP apart and each is blurred by its own part of the way.
void expect(Pixels& p, const Ellipse& rest, const Vector<7>& path, float blur) {
    constexpr double MAX_PARTS = 1000.0;
    const double way = std::hypot(path(0), path(1));
    const int parts = int(std::min(MAX_PARTS, std::max(1.0, std::ceil(way / (RIPPLE_STEP * double(blur))))));
    for (int k = 0; k < parts; k++) {
        const double t = (k + 0.5) / parts - 0.5, square = t * t + 1.0 / (12.0 * parts * parts);  // mean of t²
        const Ellipse at{rest.xx + float(t * path(4)),
                         rest.xy + float(t * path(5)),
                         rest.yy + float(t * path(6)),
                         rest.x + float(t * path(0) + square * path(2)),
                         rest.y + float(t * path(1) + square * path(3)),
                         rest.size};
        add_ellipse(p, at, float(path(0) / parts), float(path(1) / parts), blur, 1.0f / float(parts), k == 0);
    }
}

WIDE Matrix<UNKNOWNS, UNKNOWNS + 1> normal_equations(const Pixels& p, const Vector<UNKNOWNS>& x) {
    const Light light(x);
    Columns A;
    Sums sums = {};
    for (size_t first = 0; first < p.size; first += BLOCK * LANES) {
        const size_t n = std::min(BLOCK, (p.size - first) / LANES);
        for (size_t b = 0; b < n; b++) {
            const size_t i = first + b * LANES;
            const Lanes px = lanes(p.x, i), py = lanes(p.y, i), e = lanes(p.e, i), contrast = light.contrast(px, py);
            const Lanes row[UNKNOWNS + 1] = {Lanes{} + 1.0f,
                                             px,
                                             py,
                                             -e,
                                             -e * px,
                                             -e * py,
                                             -contrast * lanes(p.d[0], i),
                                             -contrast * lanes(p.d[1], i),
                                             -contrast * lanes(p.d[2], i),
                                             light.residual(p, i)};
            for (int k = 0; k <= UNKNOWNS; k++) A[k][b] = row[k];
        }
        add_products<0>(A, p.weight + first, n, sums);
    }
    Matrix<UNKNOWNS, UNKNOWNS + 1> N;
    for (int j = 0; j < UNKNOWNS; j++)
        for (int k = j; k <= UNKNOWNS; k++) {
            N(j, k) = total(sums[j][k]);
            if (k < UNKNOWNS) N(k, j) = N(j, k);
        }
    return N;
}

WIDE void biweight(Pixels& p, const Vector<UNKNOWNS>& x, float limit, float scale) {
    const Light light(x);
    const float floor = 4.685f * scale, bound = std::max(limit * light.a0, floor);
    // no rim lies beside the disc, so a deviation there is a foreign object
    const float beside = std::min(std::max(BESIDE * light.a0, floor), bound);
    const Lanes near = Lanes{} + 1.0f / (bound * bound), far = Lanes{} + 1.0f / (beside * beside);
    for (size_t i = 0; i < p.size; i += LANES) {
        const Lanes r = light.residual(p, i), u = 1.0f - r * r * (lanes(p.e, i) < CLEAR ? far : near);
        put(u > 0.0f ? u * u : Lanes{}, p.weight, i);
    }
}

void fit_background(Pixels& p, Vector<UNKNOWNS>& x, float noise) {
    for (size_t i = 0; i < p.count; i++) p.weight[i] = p.e[i] < CLEAR ? 1.0f : 0.0f;
    fit_plane(p, x);
    for (int round = 0; round < 2; round++) {
        keep_near(p, x, noise);
        fit_plane(p, x);
    }
}

WIDE double contrast_of(const Pixels& p, const Vector<UNKNOWNS>& x) {
    const Light light(x);
    Lanes depth = {}, squares = {};
    for (size_t i = 0; i < p.size; i += LANES) {
        const Lanes e = lanes(p.e, i) > 0.3f ? lanes(p.e, i) : Lanes{};
        depth -= e * light.off_background(p, i);
        squares += e * e;
    }
    return total(depth) / std::max(double(total(squares)), 1e-3);
}

WIDE void leave_out_foreign(Pixels& p, const Vector<UNKNOWNS>& x, float foreign) {
    const Light light(x);
    for (size_t i = 0; i < p.size; i += LANES) {
        const auto out = (lanes(p.e, i) < CLEAR) & (absolute(light.off_background(p, i)) > foreign);
        put(out ? Lanes{} : Lanes{} + 1.0f, p.weight, i);
    }
}

WIDE Shades shades(const Pixels& p) {
    Lanes greatest_e = {}, sum = {}, count = {}, least = Lanes{} + FILL, greatest = Lanes{} - FILL;
    for (size_t i = 0; i < p.size; i += LANES) {
        const Lanes e = lanes(p.e, i), grey = lanes(p.grey, i);
        greatest_e = e > greatest_e ? e : greatest_e;
        const auto beside = (e < CLEAR) & (grey < FILL);
        sum += beside ? grey : Lanes{};
        count += beside ? Lanes{} + 1.0f : Lanes{};
    }
    float most = 0.0f;
    for (size_t l = 0; l < LANES; l++) most = std::max(most, greatest_e[l]);
    Shades s{most, total(sum) / std::max(total(count), 1.0f), FILL, -FILL};
    for (size_t i = 0; i < p.size; i += LANES) {
        const Lanes e = lanes(p.e, i), value = s.ball + (lanes(p.grey, i) - s.ball) * (most / (e + 1e-6f));
        const auto inside = e > INSIDE * most;
        least = inside & (value < least) ? value : least;
        greatest = inside & (value > greatest) ? value : greatest;
    }
    for (size_t l = 0; l < LANES; l++) {
        s.least = std::min(s.least, least[l]);
        s.greatest = std::max(s.greatest, greatest[l]);
    }
    return s;
}

WIDE Quality quality(const Pixels& p, const Vector<UNKNOWNS>& x) {
    const Light light(x);
    Lanes fits = {}, lost = {}, rim = {}, inside = {}, squares = {}, weight = {};
    for (size_t i = 0; i < p.size; i += LANES) {
        const Lanes dx = lanes(p.d[0], i), dy = lanes(p.d[1], i), w = lanes(p.weight, i);
        const Lanes slope = root(dx * dx + dy * dy), r = light.residual(p, i);
        fits += w * slope;
        lost += w < COVERED ? slope : Lanes{};
        rim += slope;
        inside += lanes(p.e, i);
        squares += w * r * r;
        weight += w;
    }
    const double all = total(rim) + 1e-9;
    return {total(fits) / all, total(lost) / all, total(inside), total(squares), total(weight)};
}

}  // namespace spheremouse::ball
