// Alignment of a frame with the picture of the ball: the attitude that explains the contrast of most pixels.
//
// Gauss-Newton on SO(3) over the pixels where the picture changes within a pixel (Lucas and Kanade 1981; Baker and
// Matthews 2004, "Lucas-Kanade 20 years on"), with Cauchy's weights (Huber 1981, section 7.8). The error of a pixel has
// the image noise, and a part that grows with the gradient: interpolation, blur, and the picture's own errors.
#include "spheremouse/ball/texture/picture.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr int MOST = 6000;        // independent pixels: the contrasts of neighbours are means of the same grey values
constexpr int MOST_ROUNDS = 6;    // with some samples, and with all
constexpr float YOUNG = 3.0f;     // views: the place of a cell with few follows the frames that taught it
constexpr double NEAR = 2e-4;     // rad: a thirtieth of a pixel on a ball of 350 px; one step with all samples goes on
constexpr int FEW = 4000;         // samples of which some show the way
constexpr float CAUCHY = 2.385f;  // standard deviations: 95 % efficiency for normal errors
constexpr int MOST_ANCHORS = 1 << 12;

/// The residuals' model.
struct Errors {
    float noise;  // of a contrast
    float place;  // rad, of the picture's contours
};

/// A sample that counts.
struct Pixel {
    Vector3f d;  // obj
    float contrast;
};

/// A pixel against the picture.
struct Residual {
    float z, value, contrast, variance;
    Vector3f J;  // of the picture's value by a rotation of the ball, in axes of the ball
    int tile;    // of the picture
};

/// Append the residual of a pixel at `towards`, R_ball_obj, if the picture there shows a rotation by `angle` rad.
inline bool add_residual(const Pixel& pixel, const Picture& picture, const Matrix3f& towards, const Errors& errors,
                         float angle, std::vector<Residual>& all) {
    const Vector3f x = towards * pixel.d;
    const Place at = place_on(x, picture.n);
    const Look seen = look(picture, at);
    if (!(seen.weight >= LEAST_WEIGHT)) return false;
    const Vector3f J = seen.gradient.cross(x);
    const float square = J.squaredNorm(), noise = errors.noise * errors.noise;
    if (!(square * angle * angle > noise)) return false;
    const float variance = noise + errors.place * errors.place * (1.0f + YOUNG / seen.weight) * square;
    all.push_back({pixel.contrast - seen.value, seen.value, pixel.contrast, variance, J, at.tile(picture.n)});
    return true;
}

/// Return the samples that may turn with the ball, one of `every`.
std::vector<Pixel> turning(const Samples& samples, int every) {
    std::vector<Pixel> found;
    found.reserve(size_t(samples.size() / every) + 1);
    for (int row = 0, i = 0; row < samples.rows; row++)
        for (; i < (row + 1) * samples.columns; i += every)
            if (samples.odds[i] >= STATIC_ODDS && samples.direction[3 * i] < 2.0f)
                found.push_back({samples.towards(i), samples.at(row, i - row * samples.columns)});
    return found;
}

float median(std::vector<float>& values) {
    const auto middle = values.begin() + nb::ssize_t(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
}

/// Normal equations, and the number of their pixels, each by its weight.
struct Normal {
    Matrix<3> H = Matrix<3>::Zero();
    Vector<3> g = Vector<3>::Zero();
    double count = 0.0;

    void add(const Residual& one, float weight, float share) {
        const Vector<3> J = one.J.cast<double>();
        H += (double(weight) * J) * J.transpose();
        g += double(weight * one.z) * J;
        count += double(share);
    }
};

struct Aligned {
    Matrix<3> R;                             // R_obj_ball
    float scale = 0.0f, correlation = 0.0f;  // of residuals to their model; of contrast and picture
    int used = 0;
    bool converged = false;
};

/// Cauchy's weights of residuals that are `scale` times as large as their model states.
struct Weights {
    float scale;

    /// Return the share of a residual that counts, between 0 and 1.
    float share(const Residual& one) const {
        return 1.0f / (1.0f + one.z * one.z / (one.variance * CAUCHY * CAUCHY * scale * scale));
    }
    /// Return the weight of a residual that counts by a share.
    float weight(const Residual& one, float share) const { return share / (one.variance * scale * scale); }
};

/// Residuals at an attitude, and the step that they ask for.
struct Fit {
    std::vector<Residual> all;
    std::vector<float> squares;
    Weights weights{0.5f};
    float correlation = 0.0f;
    Vector<3> dx = Vector<3>::Zero();

    /// Look at pixels; return whether they determine a step.
    bool look_at(const std::vector<Pixel>& pixels, const Picture& picture, const Errors& errors, float angle,
                 const Matrix<3>& R) {
        const Matrix3f towards = R.transpose().cast<float>();
        all.clear();
        squares.clear();
        for (const Pixel& pixel : pixels)
            if (add_residual(pixel, picture, towards, errors, angle, all))
                squares.push_back(all.back().z * all.back().z / all.back().variance);
        if (squares.size() < 10) return false;
        weights.scale = std::max(1.4826f * std::sqrt(median(squares)), 0.5f);
        Normal whole;
        double qq = 0.0, mm = 0.0, qm = 0.0;
        for (const Residual& one : all) {
            const float w = weights.weight(one, weights.share(one));
            whole.add(one, w, 1.0f);
            qq += double(w * one.contrast * one.contrast);
            mm += double(w * one.value * one.value);
            qm += double(w * one.contrast * one.value);
        }
        correlation = float(qm / std::sqrt(std::max(qq * mm, 1e-300)));
        dx = (whole.H + 1e-3 * Matrix<3>::Identity()).ldlt().solve(whole.g);
        return dx.allFinite();
    }
};

/// Improve the attitude, and return the robust normal equations there by anchor, in axes of the ball.
///
/// Some samples show the way. Those that count are chosen again at each attitude: a choice at the start would take more
/// of one side of each contour, and where the picture's contrast differs from the frame's, that pulls.
Aligned align(const Samples& samples, const Picture& picture, const Errors& errors, float angle,
              const int64_t* anchor_of, Matrix<3> R, std::vector<Normal>& by_anchor) {
    Aligned r{R};
    Fit fit;
    for (int every : {std::max(samples.size() / FEW, 1), 1}) {
        const std::vector<Pixel> pixels = turning(samples, every);
        for (int round = 0; round < MOST_ROUNDS; round++) {
            const bool found = fit.look_at(pixels, picture, errors, angle, r.R);
            r.used = int(fit.all.size());
            if (!found) break;
            r.scale = fit.weights.scale;
            r.correlation = fit.correlation;
            r.R = r.R * exp(fit.dx * std::min(1.0, 0.1 / fit.dx.norm()));
            r.converged = fit.dx.cwiseAbs().maxCoeff() < NEAR;
            if (r.converged) break;
        }
    }
    if (!r.converged) return r;
    const double share_of_all = std::min(1.0, double(MOST) / double(r.used));
    for (const Residual& one : fit.all) {
        const float share = fit.weights.share(one);
        by_anchor[size_t(anchor_of[one.tile])].add(one, fit.weights.weight(one, share), share);
    }
    for (Normal& one : by_anchor) {
        one.g = share_of_all * (one.g - one.H * fit.dx);  // after the last step
        one.H *= share_of_all;
        one.count *= share_of_all;
    }
    return r;
}

nb::tuple align_texture(nb::tuple samples_, nb::tuple picture_, nb::handle R, double noise, double place, double pixel,
                        nb::handle anchor_of_, int anchors) {
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_);
    const auto anchor_of = array<const int64_t, 6, -1, -1>(anchor_of_, "anchor_of");
    if (int(anchor_of.shape(1)) != picture.tiles() || int(anchor_of.shape(2)) != picture.tiles())
        throw nb::type_error("anchor_of: must have one element for each tile of the picture");
    if (anchors < 0 || anchors > MOST_ANCHORS) throw nb::index_error("anchors: too many");
    for (size_t i = 0; i < anchor_of.size(); i++)
        if (anchor_of.data()[i] < 0 || anchor_of.data()[i] >= anchors)
            throw nb::index_error("anchor_of: no such anchor");
    const Matrix<3> start = matrix<3, 3>(R, "R");
    std::vector<Normal> by_anchor(anchors);
    Aligned r;
    {
        nb::gil_scoped_release release;
        r = align(samples, picture, {float(noise), float(place)}, float(pixel), anchor_of.data(), start, by_anchor);
    }
    auto H = zeros<double>({size_t(anchors), 3, 3}), g = zeros<double>({size_t(anchors), 3});
    auto count = zeros<double>({size_t(anchors)});
    for (int k = 0; k < anchors; k++) {
        const Normal& one = by_anchor[size_t(k)];
        Eigen::Map<Matrix<3>>(H.data() + 9 * k) = r.R * one.H * r.R.transpose();
        Eigen::Map<Vector<3>>(g.data() + 3 * k) = r.R * one.g;
        count.data()[k] = one.count;
    }
    return nb::make_tuple(to_numpy(r.R), r.scale, r.correlation, r.used, r.converged, H, g, count);
}

/// Return the `most` samples of greatest contrast that may turn with the ball.
std::vector<Pixel> strongest(const Samples& samples, int most) {
    std::vector<Pixel> found;
    for (int row = 0, i = 0; row < samples.rows; row++)
        for (int column = 0; column < samples.columns; column++, i++)
            if (samples.odds[i] >= STATIC_ODDS && samples.direction[3 * i] < 2.0f)
                found.push_back({samples.towards(i), samples.at(row, column)});
    const auto end = found.begin() + std::clamp<nb::ssize_t>(most, 0, nb::ssize_t(found.size()));
    if (end != found.end())
        std::nth_element(found.begin(), end, found.end(),
                         [](const Pixel& a, const Pixel& b) { return std::abs(a.contrast) > std::abs(b.contrast); });
    found.erase(end, found.end());
    return found;
}

/// Return the correlation of frame and picture at each attitude, 0 where the picture knows less than half of it.
NewArray<double> correlate_texture(nb::tuple samples_, nb::tuple picture_, nb::handle attitudes_, int most) {
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_);
    const auto attitudes = matrices<3, 3>(attitudes_, "attitudes");
    auto result = zeros<double>({size_t(attitudes.rows())});
    nb::gil_scoped_release release;
    const std::vector<Pixel> pixels = strongest(samples, most);
    for (nb::ssize_t k = 0; k < attitudes.rows(); k++) {
        const Matrix3f turned = Matrix<3>(View<3, 3>(attitudes.row(k).data()).transpose()).cast<float>();
        float qq = 0.0f, mm = 0.0f, qm = 0.0f;
        size_t known = 0;
        for (const Pixel& pixel : pixels) {
            const Place p = place_on(turned * pixel.d, picture.n);
            const size_t at =
                (size_t(p.face) * picture.n + p.row + (p.down > 0.5f)) * picture.n + p.column + (p.right > 0.5f);
            if (picture.weight[at] < LEAST_WEIGHT) continue;
            const float q = pixel.contrast, m = picture.value[at];
            qq += q * q;
            mm += m * m;
            qm += q * m;
            known++;
        }
        if (2 * known > pixels.size() && qq * mm > 0.0f) result.data()[k] = double(qm / std::sqrt(qq * mm));
    }
    return result;
}

}  // namespace

Picture read_picture(nb::tuple picture) {
    members(picture, 2, "picture");
    const auto value = array<float, 6, -1, -1>(picture[0], "value");
    const auto weight = array<float, 6, -1, -1>(picture[1], "weight");
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
    const auto offset = array<const float, -1, -1>(samples[3], "offset");
    const int64_t step = number<int>(samples[4], "samples");
    const int rows = int(direction.shape(0)), columns = int(direction.shape(1));
    for (const auto& each : {odds, offset})
        if (int(each.shape(0)) != rows || int(each.shape(1)) != columns)
            throw nb::type_error("odds, offset: must have the shape of direction");
    if (step < 1 || (rows - 1) * step >= int64_t(contrast.shape(0)) ||
        (columns - 1) * step >= int64_t(contrast.shape(1)))
        throw nb::type_error("contrast: must have a pixel for each sample");
    return {contrast.data(), direction.data(), odds.data(), offset.data(), int(contrast.shape(1)), rows,
            columns,         int(step)};
}

void bind_align(nb::module_& m) {
    m.def("align_texture", &align_texture, arg("samples"), arg("picture"), arg("R"), arg("noise"), arg("place"),
          arg("pixel"), arg("anchor_of"), arg("anchors"));
    m.def("correlate_texture", &correlate_texture, arg("samples"), arg("picture"), arg("attitudes"), arg("most"));
}

}  // namespace spheremouse::ball
