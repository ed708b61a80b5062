// Alignment of a frame with the picture of the ball: the attitude that explains the contrast of most pixels.
//
// Gauss-Newton on SO(3) over the pixels where the picture changes within a pixel (Lucas and Kanade 1981; Baker and
// Matthews 2004, "Lucas-Kanade 20 years on"), with Cauchy's weights (Huber 1981, section 7.8). The error of a pixel has
// the image noise, and a part that grows with the gradient: interpolation, blur, and the picture's own errors.
#include "spheremouse/ball/texture/picture.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr float LEAST_WEIGHT = 0.08f;  // of a cell: one oblique view
constexpr float STATIC_ODDS = -3.0f;   // log odds below which a pixel does not turn with the ball
constexpr int MOST = 6000;             // pixels: more add time and little information
constexpr int MOST_ROUNDS = 10;
constexpr double CONVERGED = 1e-5;  // rad: a five hundredth of a pixel on a ball of 400 px; the anchors have the rest
constexpr float YOUNG = 3.0f;       // views: the place of a cell with few follows the frames that taught it
constexpr double NEAR = 1e-3;       // rad: from there on all pixels count
constexpr size_t FEW = 800;         // pixels that show the way
constexpr float CAUCHY = 2.385f;    // standard deviations: 95 % efficiency for normal errors

/// The residuals' model.
struct Errors {
    float noise;  // of a contrast
    float place;  // rad, of the picture's contours
};

/// A pixel against the picture.
struct Residual {
    float z, value, contrast, variance;
    Vector3f J;  // of the picture's value by a rotation of the ball, obj
};

/// Return the residual of a pixel; its variance is infinite where the picture is empty.
Residual residual(const Samples& samples, const Picture& picture, const Matrix3f& R, const Errors& errors, int i) {
    const Vector3f d = samples.towards(i);
    const Look seen = look(picture, R.transpose() * d);
    Residual r;
    r.J = (R * seen.gradient).cross(d);
    r.contrast = samples.at(i);
    r.value = seen.value;
    r.z = r.contrast - seen.value;
    r.variance = seen.weight < LEAST_WEIGHT
                     ? std::numeric_limits<float>::infinity()
                     : errors.noise * errors.noise +
                           errors.place * errors.place * (1.0f + YOUNG / seen.weight) * r.J.squaredNorm();
    return r;
}

/// Return the pixels that show a rotation by `pixel` rad: each changes by its noise.
std::vector<int> informative(const Samples& samples, const Picture& picture, const Matrix3f& R, const Errors& errors,
                             float pixel) {
    std::vector<int> found;
    for (int i = 0; i < samples.size(); i++) {
        if (!(samples.direction[3 * size_t(i)] < 2.0f) || samples.odds[i] < STATIC_ODDS) continue;
        if (std::abs(samples.at(i) - samples.before[i]) < 2.0f * errors.noise) continue;
        const Residual r = residual(samples, picture, R, errors, i);
        if (std::isfinite(r.variance) && pixel * pixel * r.J.squaredNorm() > errors.noise * errors.noise)
            found.push_back(i);
    }
    if (int(found.size()) <= MOST) return found;
    std::vector<int> kept;
    for (int k = 0; k < MOST; k++) kept.push_back(found[size_t(k) * found.size() / MOST]);
    return kept;
}

float median(std::vector<float>& values) {
    const auto middle = values.begin() + nb::ssize_t(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

/// The normal equations of the pixels nearest to each anchor, or of all.
struct Normal {
    std::vector<Matrix<3>> H;
    std::vector<Vector<3>> g;
    Vector<Dynamic> count;

    explicit Normal(int n) : H(n, Matrix<3>::Zero()), g(n, Vector<3>::Zero()), count(Vector<Dynamic>::Zero(n)) {}
};

struct Aligned {
    Matrix<3> R;
    float scale = 0.0f, correlation = 0.0f;  // of residuals to their model; of contrast and picture
    int used = 0;
    bool converged = false;
};

Matrix3f narrow(const Matrix<3>& R) { return R.cast<float>(); }

/// Improve the attitude, and return the robust normal equations there by anchor.
Aligned align(const Samples& samples, const Picture& picture, const Errors& errors, float pixel,
              const int64_t* anchor_of, Matrix<3> R, Normal& by_anchor) {
    const std::vector<int> pixels = informative(samples, picture, narrow(R), errors, pixel);
    Aligned r{R};
    r.used = int(pixels.size());
    if (pixels.size() < 10) return r;
    std::vector<Residual> all(pixels.size());
    std::vector<float> size(pixels.size());
    size_t step = pixels.size() > 4 * FEW ? pixels.size() / FEW : 1;  // first a part of the pixels shows the way
    for (int round = 0; round < MOST_ROUNDS; round++) {
        const Matrix3f now = narrow(R);
        size.clear();
        for (size_t k = 0; k < pixels.size(); k += step) {
            all[k] = residual(samples, picture, now, errors, pixels[k]);
            if (std::isfinite(all[k].variance)) size.push_back(std::abs(all[k].z) / std::sqrt(all[k].variance));
        }
        if (size.size() < 10) return r;
        r.scale = std::max(1.4826f * median(size), 0.5f);
        Normal whole(1);
        double qq = 0.0, mm = 0.0, qm = 0.0;
        const float limit = 1.0f / (CAUCHY * CAUCHY * r.scale * r.scale);
        for (size_t k = 0; k < pixels.size(); k += step) {
            const Residual& one = all[k];
            if (!std::isfinite(one.variance)) continue;
            const float information = 1.0f / one.variance;
            const float w = information / (r.scale * r.scale) / (1.0f + one.z * one.z * information * limit);
            const Vector3f J = w * one.J;
            whole.H[0] += (J * one.J.transpose()).cast<double>();
            whole.g[0] += (J * one.z).cast<double>();
            qq += double(w * one.contrast * one.contrast);
            mm += double(w * one.value * one.value);
            qm += double(w * one.contrast * one.value);
        }
        r.correlation = float(qm / std::sqrt(std::max(qq * mm, 1e-300)));
        const Vector<3> dx = (whole.H[0] + 1e-3 * Matrix<3>::Identity()).ldlt().solve(whole.g[0]);
        if (!dx.allFinite()) return r;
        const double most = dx.cwiseAbs().maxCoeff();
        if (step == 1 && (most < CONVERGED || round == MOST_ROUNDS - 1)) {
            r.converged = most < 10.0 * CONVERGED;
            break;
        }
        R = exp(dx * std::min(1.0, 0.1 / dx.norm())) * R;
        if (most < NEAR || round == MOST_ROUNDS - 3) step = 1;
    }
    r.R = R;
    const Matrix3f now = narrow(R);
    const float limit = 1.0f / (CAUCHY * CAUCHY * r.scale * r.scale);
    for (size_t k = 0; k < pixels.size(); k++) {
        const Residual& one = all[k];
        if (!std::isfinite(one.variance)) continue;
        const Place p = place_on(now.transpose() * samples.towards(pixels[k]), picture.n);
        const int tiles = picture.tiles();
        const auto anchor = size_t(anchor_of[(size_t(p.face) * tiles + p.row / TILE) * tiles + p.column / TILE]);
        const float information = 1.0f / one.variance;
        const float share = 1.0f / (1.0f + one.z * one.z * information * limit);
        const float w = information / (r.scale * r.scale) * share;
        by_anchor.H[anchor] += (w * one.J * one.J.transpose()).cast<double>();
        by_anchor.g[anchor] += (w * one.z * one.J).cast<double>();
        by_anchor.count(nb::ssize_t(anchor)) += share;
    }
    return r;
}

nb::tuple align_texture(nb::tuple samples_, nb::tuple picture_, nb::handle R, double noise, double place, double pixel,
                        nb::handle anchor_of_, int anchors) {
    members(picture_, 2, "picture");
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_[0], picture_[1]);
    const auto anchor_of = array<const int64_t, 6, -1, -1>(anchor_of_, "anchor_of");
    if (int(anchor_of.shape(1)) != picture.tiles() || int(anchor_of.shape(2)) != picture.tiles())
        throw nb::type_error("anchor_of: must have one element for each tile of the picture");
    for (size_t i = 0; i < anchor_of.size(); i++)
        if (anchor_of.data()[i] < 0 || anchor_of.data()[i] >= anchors)
            throw nb::index_error("anchor_of: no such anchor");
    const Matrix<3> start = matrix<3, 3>(R, "R");
    Normal by_anchor(anchors);
    Aligned r;
    {
        nb::gil_scoped_release release;
        r = align(samples, picture, {float(noise), float(place)}, float(pixel), anchor_of.data(), start, by_anchor);
    }
    auto H = zeros<double>({size_t(anchors), 3, 3}), g = zeros<double>({size_t(anchors), 3});
    for (int k = 0; k < anchors; k++) {
        std::copy_n(by_anchor.H[size_t(k)].data(), 9, H.data() + 9 * k);
        std::copy_n(by_anchor.g[size_t(k)].data(), 3, g.data() + 3 * k);
    }
    return nb::make_tuple(to_numpy(r.R), r.scale, r.correlation, r.used, r.converged, H, g, to_numpy(by_anchor.count));
}

/// Return the `most` samples of greatest contrast that may turn with the ball.
std::vector<int> strongest(const Samples& samples, int most) {
    std::vector<int> found;
    for (int i = 0; i < samples.size(); i++)
        if (samples.direction[3 * size_t(i)] < 2.0f && samples.odds[i] >= STATIC_ODDS) found.push_back(i);
    const auto stronger = [&](int a, int b) {
        const float x = std::abs(samples.at(a)), y = std::abs(samples.at(b));
        return x > y || (x == y && a < b);
    };
    const auto end = found.begin() + std::clamp<nb::ssize_t>(most, 0, nb::ssize_t(found.size()));
    std::partial_sort(found.begin(), end, found.end(), stronger);
    found.erase(end, found.end());
    return found;
}

/// Return the correlation of frame and picture at each attitude, 0 where the picture knows less than half of it.
NewArray<double> correlate_texture(nb::tuple samples_, nb::tuple picture_, nb::handle attitudes_, int most) {
    members(picture_, 2, "picture");
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_[0], picture_[1]);
    const auto attitudes = matrices<3, 3>(attitudes_, "attitudes");
    auto result = zeros<double>({size_t(attitudes.rows())});
    nb::gil_scoped_release release;
    std::vector<Vector3f> towards;
    std::vector<float> contrast;
    for (int i : strongest(samples, most)) {
        towards.push_back(samples.towards(i));
        contrast.push_back(samples.at(i));
    }
    for (nb::ssize_t k = 0; k < attitudes.rows(); k++) {
        const Matrix3f turned = Matrix<3>(View<3, 3>(attitudes.row(k).data()).transpose()).cast<float>();
        float qq = 0.0f, mm = 0.0f, qm = 0.0f;
        size_t known = 0;
        for (size_t i = 0; i < towards.size(); i++) {
            const Place p = place_on(turned * towards[i], picture.n);
            const size_t at =
                (size_t(p.face) * picture.n + p.row + (p.down > 0.5f)) * picture.n + p.column + (p.right > 0.5f);
            if (picture.weight[at] < LEAST_WEIGHT) continue;
            const float q = contrast[i], m = picture.value[at];
            qq += q * q;
            mm += m * m;
            qm += q * m;
            known++;
        }
        if (2 * known > towards.size() && qq * mm > 0.0f) result.data()[k] = double(qm / std::sqrt(qq * mm));
    }
    return result;
}

}  // namespace

Picture read_picture(nb::handle value_, nb::handle weight_) {
    const auto value = array<float, 6, -1, -1>(value_, "value"), weight = array<float, 6, -1, -1>(weight_, "weight");
    const int n = int(value.shape(1));
    if (n < TILE || n % TILE || int(value.shape(2)) != n || int(weight.shape(1)) != n || int(weight.shape(2)) != n)
        throw nb::type_error("value, weight: must have the shape (6, n, n), n a multiple of 8");
    return {value.data(), weight.data(), n};
}

Samples read_samples(nb::tuple samples) {
    members(samples, 5, "samples");
    const auto contrast = array<const float, -1, -1>(samples[0], "contrast");
    const auto direction = array<const float, -1, -1, 3>(samples[1], "direction");
    const auto odds = array<const float, -1, -1>(samples[2], "odds");
    const auto before = array<const float, -1, -1>(samples[3], "before");
    const int step = number<int>(samples[4], "samples");
    const int rows = int(direction.shape(0)), columns = int(direction.shape(1));
    for (const auto& each : {odds, before})
        if (int(each.shape(0)) != rows || int(each.shape(1)) != columns)
            throw nb::type_error("odds, before: must have the shape of direction");
    if (step < 1 || (rows - 1) * step >= int(contrast.shape(0)) || (columns - 1) * step >= int(contrast.shape(1)))
        throw nb::type_error("contrast: must have a pixel for each sample");
    return {contrast.data(), direction.data(), odds.data(), before.data(), int(contrast.shape(1)), rows, columns, step};
}

void bind_align(nb::module_& m) {
    m.def("align_texture", &align_texture, arg("samples"), arg("picture"), arg("R"), arg("noise"), arg("place"),
          arg("pixel"), arg("anchor_of"), arg("anchors"));
    m.def("correlate_texture", &correlate_texture, arg("samples"), arg("picture"), arg("attitudes"), arg("most"));
}

}  // namespace spheremouse::ball
