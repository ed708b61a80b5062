// Log-likelihood ratio of poses: one pass over poses x points. `likelihood.py` has the equations.
#include "spheremouse/wand/kernels.h"

namespace spheremouse::wand {
namespace {

constexpr double KERNEL_AREA = 2.0 * PI * FIELD_SIGMA * FIELD_SIGMA;  // px²
constexpr int TABLE = 511;                                            // steps of |m - e|
constexpr float PER_SIGMA = float(1.0 / FIELD_SIGMA), HALF_SIGMA = float(0.5 * FIELD_SIGMA);
constexpr double MIN_EXPECTED = 0.3;      // of the field's range, in the match
constexpr double MATCH_TOLERANCE = 0.25;  // of the field's range

/// Standard normal distribution function and density, to 0.02f %: the logistic function of a cubic (Bowling et al.
/// 2009), with the hyperbolic tangent as a continued fraction.
struct Normal {
    float cdf, pdf;

    explicit Normal(float argument) {
        const float x = std::min(std::max(argument, -3.6f), 3.6f), xx = x * x;
        const float y = x * (0.7988f + 0.03528f * xx), yy = y * y;
        const float t = y * (135135.0f + yy * (17325.0f + yy * (378.0f + yy))) /
                        (135135.0f + yy * (62370.0f + yy * (3150.0f + 28.0f * yy)));
        cdf = 0.5f + 0.5f * t;
        pdf = 0.5f * (1.0f - t * t) * (0.7988f + 0.10584f * xx);
    }
};

/// Return 2 / pi times the arc sine, to 5e-5 (Abramowitz, Stegun 1964, 4.4.45).
inline float scaled_asin(float sine) {
    const float x = std::min(std::abs(sine), 1.0f);
    const float rest = std::sqrt(1.0f - x) * (1.0f - x * (0.1350363f - x * (0.0472763f - x * 0.0119235f)));
    return sine > 0.0f ? 1.0f - rest : rest - 1.0f;
}

/// Write the expected field e and de / d(rim offset) of n points. The arguments are those of `kernels.expected_field`.
///
/// The last one is the standard deviation of a rim's blur, px. A rim alone is selected s px inward, where a pixel has
/// the fraction Phi(s / blur) of print. Another rim w px away takes print away too. There the pixel that is selected
/// lies x px inward, with Phi(x / blur) + Phi((w - x) / blur) - 1 = Phi(s / blur): one step of Newton's method from s.
WIDE void expect(size_t n, const std::vector<float> (&argument)[9], float* e_out, float* g_out) {
    const float *along = argument[0].data(), *outward = argument[1].data(), *facing = argument[2].data();
    const float *scale = argument[3].data(), *inside = argument[4].data(), *width = argument[5].data();
    const float *bend = argument[6].data(), *offset = argument[7].data(), *blur = argument[8].data();
#pragma GCC ivdep
    for (size_t i = 0; i < n; i++) {
        const float per_root = 1.0f / std::sqrt(std::max(1.0f - along[i] * along[i], 0.02f));
        const float across = scale[i] * facing[i] * per_root * PER_SIGMA;  // field sigmas per rad, across the rim
        // a blurred rim of curvature k moves inward by k s² / 2
        const float wider = 1.0f + blur[i] * blur[i] * PER_SIGMA * PER_SIGMA;
        const float bent = HALF_SIGMA * wider * facing[i] * bend[i] * per_root * per_root * per_root / scale[i];
        const float apart = (inside[i] + width[i]) * across * float(FIELD_SIGMA), alone = -offset[i];
        const float per_blur = 1.0f / blur[i];
        const Normal here(alone * per_blur), opposite((apart - alone) * per_blur);
        const float both = alone + blur[i] * (1.0f - opposite.cdf) / std::max(here.pdf - opposite.pdf, 0.05f);
        const float shift = std::min(bent, 0.8f) + std::min(both, std::max(0.5f * apart, alone)) * PER_SIGMA;
        const Normal near(inside[i] * across - shift), far(width[i] * across - shift);
        const float disc = std::max(near.cdf + far.cdf - 1.0f, 0.0f), slope = near.pdf + far.pdf;
        // disc and limb are two half planes, hence two Gaussian variables; exact for a point on both edges
        const float aside = std::sqrt(std::max(1.0f - facing[i] * facing[i], 1e-6f));
        const float ball = Normal(scale[i] * (1.0f - aside) * PER_SIGMA).cdf;
        const float v = scaled_asin(outward[i] / aside * per_root), weight = std::abs(v);
        const float same_way = v > 0.0f ? std::min(disc, ball) : std::max(disc + ball - 1.0f, 0.0f);
        const float limit = v > 0.0f ? ball - disc : disc + ball - 1.0f;  // above 0 the rim limits the overlap
        e_out[i] = (1.0f - weight) * disc * ball + weight * same_way;
        g_out[i] = ((1.0f - weight) * slope * ball + (limit > 0.0f ? weight * slope : 0.0f)) * PER_SIGMA;
    }
}

/// Write the view of all points of a ball: one product with a direction in the ball's axes gives each angle.
WIDE void project(const BallModel& ball, const Pose& pose, const FieldsView& fields, Sight& s) {
    const Camera<float> lens = ball.camera;
    const float per_factor = float(1.0 / fields.factor), left = float(fields.left - 0.5), top = float(fields.top - 0.5);
    const float px_per_rad = float(ball.camera.fx * ball.radius / fields.factor);
    const Eigen::Matrix3f R = pose.R.cast<float>();
    const Eigen::Vector3f c = (pose.R.transpose() * pose.c).cast<float>(), p = pose.c.cast<float>();
    const float a = float(ball.radius), x0 = p[0], y0 = p[1], z0 = p[2];
    const float c0 = c[0], c1 = c[1], c2 = c[2], squared = x0 * x0 + y0 * y0 + z0 * z0 - a * a;
    const float r00 = R(0, 0), r01 = R(0, 1), r02 = R(0, 2), r10 = R(1, 0), r11 = R(1, 1);
    const float r12 = R(1, 2), r20 = R(2, 0), r21 = R(2, 1), r22 = R(2, 2);
    const float *u0 = ball.column[0].data(), *u1 = ball.column[1].data(), *u2 = ball.column[2].data();
    const float *t0 = ball.column[3].data(), *t1 = ball.column[4].data(), *t2 = ball.column[5].data();
    const float *o0 = ball.column[6].data(), *o1 = ball.column[7].data(), *o2 = ball.column[8].data();
    float *facing = s.facing.data(), *x = s.x.data(), *y = s.y.data(), *along = s.along.data();
    float *outward = s.outward.data(), *scale = s.scale.data(), *depth = s.depth.data();
    const size_t size = ball.size;
#pragma GCC ivdep
    for (size_t q = 0; q < size; q++) {
        const float towards = u0[q] * c0 + u1[q] * c1 + u2[q] * c2 + a;
        const float per_length = 1.0f / std::sqrt(squared + (a + a) * towards);
        const float z = z0 + a * (r20 * u0[q] + r21 * u1[q] + r22 * u2[q]), per_z = 1.0f / z;
        facing[q] = -towards * per_length;
        float u, v;
        lens.pixel((x0 + a * (r00 * u0[q] + r01 * u1[q] + r02 * u2[q])) * per_z,
                   (y0 + a * (r10 * u0[q] + r11 * u1[q] + r12 * u2[q])) * per_z, u, v);
        x[q] = (u - left) * per_factor - 0.5f;
        y[q] = (v - top) * per_factor - 0.5f;
        along[q] = per_length * (t0[q] * c0 + t1[q] * c1 + t2[q] * c2);
        outward[q] = per_length * (o0[q] * c0 + o1[q] * c1 + o2[q] * c2);
        scale[q] = px_per_rad * per_length;
        depth[q] = z;
    }
}

/// Write the px by which each point of a ball moves across its rim during the exposure.
WIDE void blur(const BallModel& ball, const Pose& pose, const FieldsView& fields, Sight& s) {
    const double per_radius = 1.0 / ball.radius;
    const Eigen::Vector3f c = (per_radius * pose.R.transpose() * pose.c).cast<float>();
    const Eigen::Vector3f shift = (per_radius * pose.R.transpose() * fields.exposure_motion.head<3>()).cast<float>();
    const Eigen::Vector3f turn = (pose.R.transpose() * fields.exposure_motion.tail<3>()).cast<float>();
    const float c0 = c[0], c1 = c[1], c2 = c[2], m0 = shift[0], m1 = shift[1], m2 = shift[2];
    const float w0 = turn[0], w1 = turn[1], w2 = turn[2], per_focal = float(fields.factor / ball.camera.fx);
    const float *u0 = ball.column[0].data(), *u1 = ball.column[1].data(), *u2 = ball.column[2].data();
    const float *t0 = ball.column[3].data(), *t1 = ball.column[4].data(), *t2 = ball.column[5].data();
    const float *scale = s.scale.data(), *along = s.along.data();
    float* across = s.across.data();
    const size_t size = ball.size;
#pragma GCC ivdep
    for (size_t q = 0; q < size; q++) {
        const float v0 = m0 + w1 * u2[q] - w2 * u1[q], v1 = m1 + w2 * u0[q] - w0 * u2[q];
        const float v2 = m2 + w0 * u1[q] - w1 * u0[q], r0 = c0 + u0[q], r1 = c1 + u1[q], r2 = c2 + u2[q];
        const float n0 = t1[q] * r2 - t2[q] * r1, n1 = t2[q] * r0 - t0[q] * r2, n2 = t0[q] * r1 - t1[q] * r0;
        const float image_of_tangent = std::sqrt(std::max(1.0f - along[q] * along[q], 0.02f));
        across[q] = std::abs(v0 * n0 + v1 * n1 + v2 * n2) * scale[q] * scale[q] * per_focal / image_of_tangent;
    }
}

/// Return the offset of a rim, px outward, that moves by `across` px across itself during the exposure.
///
/// It becomes a ramp of that width. A pixel of the ramp is selected from a fraction `cover` of print on: (1 / 2 - cover)
/// of the ramp outward from the rim at mid-exposure. The lens' blur, with the offset `rim`, adds as two widths do.
inline float blurred_rim(float rim, float cover, float across) {
    const float outward = (0.5f - cover) * across;
    return std::copysign(std::sqrt(rim * rim + outward * outward), outward);
}

/// Tables over |m - e| of the densities in the ratio, in steps of 1 / 511.
struct Densities {
    std::vector<double> normal, agree, bare;      // N(m - e); (1 - o) N(m - e); log of that plus o
    std::vector<std::vector<double>> per_chance;  // 1 / B(e), of each colour

    explicit Densities(double sigma) {
        for (int i = 0; i <= TABLE; i++) {
            const double d = double(i) / TABLE / sigma;
            normal.push_back(std::exp(-0.5 * d * d));
            agree.push_back((1.0 - OUTLIER) * normal.back());
            bare.push_back(std::log(agree.back() + OUTLIER));
        }
    }

    Densities(const FieldsView& fields, double sigma) {
        static thread_local double last_sigma = 0.0;  // the tracker has two
        static thread_local Densities last(1.0);
        if (sigma != last_sigma) last = Densities(last_sigma = sigma);
        *this = last;
        for (double p : fields.fraction) {
            per_chance.emplace_back(normal);
            for (double& n : per_chance.back()) n = 1.0 / ((1.0 - p) * n + p);
        }
    }

    static size_t index(double d) { return size_t(int(std::min(std::max(0.0, d), 1.0) * TABLE + 0.5)); }
};

/// Sums of one pose over its points.
struct Ratio {
    double log_ratio = 0.0, matched = 0.0, expected = 0.0;
};

/// Return the log-likelihood ratio, and the sums of the match.
Ratio ratio(const BallModel& ball, const FieldsView& fields, const Densities& density, double sigma, const Sight& s) {
    Ratio sum;
    const double variance = sigma * sigma;
    std::vector<double> product(s.disc_weight.size(), 1.0), rg(fields.rim.size()), gg(fields.rim.size());
    for (size_t i = 0; i < s.bare; i++) {
        for (size_t k = 0; k < fields.rim.size(); k++) {
            const double m = fields.weight.at(int(k), s.bare_x[i], s.bare_y[i]);
            if (m > 0.0) sum.log_ratio += s.bare_w[i] * density.bare[Densities::index(m)];
            if (m > 0.5) sum.expected += s.bare_w[i];
        }
    }
    for (size_t i = 0; i < s.coloured; i++) {
        const size_t k = size_t(ball.colour[s.index[i]]);
        const double m = s.m[i], e = s.e[i], r = s.r[i], w = s.w[i], g = s.g[i];
        const double near = density.agree[Densities::index(std::abs(r))];
        // a picture without the ball has by chance the value e, or less in glare
        const double each = near * density.per_chance[k][Densities::index(m - r)] + OUTLIER;
        const size_t disc = size_t(ball.disc[s.index[i]]);
        if (w == s.disc_weight[disc]) {
            product[disc] *= each;
        } else {
            sum.log_ratio += w * std::log(each);
        }
        const double inlier = w * near / (near + OUTLIER);  // the offset explains a displaced rim, not a missing one
        rg[k] += inlier * r * g;
        gg[k] += inlier * g * g;
        if (s.hidden[i] > 0.0 && m < MIN_EXPECTED) continue;  // glare shows no colour
        if (e > MIN_EXPECTED) {
            sum.expected += w;
            sum.matched += w * (std::abs(r) < MATCH_TOLERANCE ? 1.0 : std::min(m / e, 1.0));
        } else if (m > 0.5) {
            sum.expected += w;
        }
    }
    for (size_t d = 0; d < product.size(); d++) sum.log_ratio += s.disc_weight[d] * std::log(product[d]);
    for (size_t k = 0; k < rg.size(); k++) {  // the common offset, marginalised
        const double prior = fields.rim[k].sigma * fields.rim[k].sigma;
        const double information = 1.0 / prior + gg[k] / variance, b = rg[k] / variance;
        sum.log_ratio += 0.5 * b * b / information - 0.5 * std::log(information * prior);
    }
    return sum;
}

nb::tuple log_likelihood(nb::handle position_, nb::handle rotation_, const BallModel& ball, const FieldsView& fields,
                         double sigma, nb::handle disc_weight_, nb::handle which_) {
    const auto position = array<const double, -1, 3>(position_, "position");
    const auto rotation = array<const double, -1, 3, 3>(rotation_, "rotation");
    const auto disc_weight = array<const double, -1, -1>(disc_weight_, "disc_weight");
    const auto which = array<const int64_t, -1>(which_, "which");
    const size_t n = position.shape(0), k = disc_weight.shape(0);
    fields.require_colours_of(ball);
    if (rotation.shape(0) != n) throw nb::type_error("rotation: must have as many poses as position");
    if (k > 0 && (which.shape(0) != n || disc_weight.shape(1) != ball.first.size()))
        throw nb::type_error("disc_weight: must have a column for each disc, and which an index for each pose");
    for (size_t i = 0; k > 0 && i < n; i++)
        if (which(i) >= int64_t(k)) throw nb::type_error("which: must be an index of disc_weight");
    sigma = std::max(sigma, fields.sigma);
    auto value = zeros<double>({n}), match = zeros<double>({n});
    double *value_ = value.data(), *match_ = match.data();
    nb::gil_scoped_release release;
    const Densities density(fields, sigma);
    Sight s(ball.size);
    for (size_t i = 0; i < n; i++) {
        const Pose pose{Eigen::Map<const Vector3d>(&position(i, 0)), Eigen::Map<const Matrix<3>>(&rotation(i, 0, 0))};
        measure(ball, fields, pose, k > 0 && which(i) >= 0 ? &disc_weight(size_t(which(i)), 0) : nullptr, s);
        const Ratio sum = ratio(ball, fields, density, sigma, s);
        value_[i] = sum.log_ratio;
        match_[i] = sum.expected > 0.0 ? sum.matched / sum.expected : 0.0;
    }
    nb::gil_scoped_acquire acquire;
    return nb::make_tuple(value, match);
}

nb::tuple evidence_bounds(nb::handle position_, nb::handle rotation_, const BallModel& ball, const FieldsView& fields) {
    const auto position = array<const double, -1, 3>(position_, "position");
    const auto rotation = array<const double, -1, 3, 3>(rotation_, "rotation");
    const size_t n = position.shape(0);
    fields.require_colours_of(ball);
    if (rotation.shape(0) != n) throw nb::type_error("rotation: must have as many poses as position");
    const size_t colours = fields.rim.size();
    auto hidden = zeros<double>({n, colours}), clear = zeros<double>({n, colours});
    const Densities density(fields, fields.sigma);
    Sight s(ball.size);
    for (size_t i = 0; i < n; i++) {
        const Pose pose{Eigen::Map<const Vector3d>(&position(i, 0)), Eigen::Map<const Matrix<3>>(&rotation(i, 0, 0))};
        measure(ball, fields, pose, nullptr, s);
        for (size_t at = 0; at < s.coloured; at++) {
            const size_t e = Densities::index(s.e[at]), k = size_t(ball.colour[s.index[at]]);
            const double chance = density.per_chance[k][e];
            hidden.data()[i * colours + k] += s.w[at] * std::log(density.agree[e] * chance + OUTLIER);
            clear.data()[i * colours + k] += s.w[at] * std::log(density.agree[0] * chance + OUTLIER);
        }
    }
    return nb::make_tuple(hidden, clear);
}

nb::tuple expected_field(nb::handle points_) {
    const auto points = array<const float, -1, 9>(points_, "points");
    const size_t n = points.shape(0);
    auto e = zeros<float>({n}), g = zeros<float>({n});
    std::vector<float> argument[9];
    for (size_t k = 0; k < 9; k++) {
        for (size_t i = 0; i < n; i++) argument[k].push_back(points(i, k));
    }
    expect(n, argument, e.data(), g.data());
    return nb::make_tuple(e, g);
}

}  // namespace

BallModel::BallModel(nb::handle table_, nb::handle colour_, double radius, nb::handle lens_) : radius(radius) {
    const auto table = array<const double, -1, 10>(table_, "table");
    const auto index = array<const int64_t, -1>(colour_, "colour");
    const auto lens = array<const double, 9>(lens_, "lens");
    size = table.shape(0);
    if (index.shape(0) != size) throw nb::type_error("colour: must have a value for each row of table");
    if (size > 0 && !(table(0, 9) > 0.0)) throw nb::type_error("table: must begin with the centre of a disc");
    camera = {lens(0), lens(1), lens(2), lens(3), lens(4), lens(5), lens(6), lens(7), lens(8)};
    for (size_t q = 0; q < size; q++) {
        const double* p = &table(q, 0);
        const Vector3d out = Vector3d(p[3], p[4], p[5]).cross(Vector3d(p[0], p[1], p[2]));
        const double row[12] = {p[0], p[1], p[2], p[3], p[4], p[5], out[0], out[1], out[2], p[6], p[7], p[8]};
        for (size_t k = 0; k < 12; k++) column[k].push_back(float(row[k]));
        if (p[9] > 0.0) first.push_back(q), solid_angle.push_back(p[9]);
        colour.push_back(int(index(q)));
        disc.push_back(int(first.size()) - 1);
    }
}

/// Return the noise of a rim over that of one in focus. A pixel's width adds to a part that grows as the blur.
static double rim_noise(double blur) { return std::sqrt((1.0 + blur * blur) / (1.0 + SHARP_RIM * SHARP_RIM)); }

FieldsView::FieldsView(nb::handle weight_, nb::handle glare_, nb::handle place_, nb::handle fraction_, nb::handle rims_,
                       nb::handle exposure_motion_)
    : arrays_{array<const uint8_t, -1, -1, -1>(weight_, "weight"), array<const uint8_t, -1, -1, -1>(glare_, "glare")} {
    Planes* planes[] = {&weight, &glare};
    for (int i : {0, 1})
        *planes[i] = {arrays_[i].data(), arrays_[i].shape(0), int(arrays_[i].shape(1)), int(arrays_[i].shape(2))};
    const auto place = array<const double, 3>(place_, "place");
    const auto p = array<const double, -1>(fraction_, "fraction");
    const auto rims = array<const double, -1, 4>(rims_, "rims");
    const auto motion = array<const double, 6>(exposure_motion_, "exposure_motion");
    if (p.shape(0) != weight.count) throw nb::type_error("fraction: must have a value for each colour");
    if (rims.shape(0) != weight.count) throw nb::type_error("rims: must have a row for each colour");
    if (glare.count > 0 && (glare.height != weight.height || glare.width != weight.width))
        throw nb::type_error("glare: must have the size of weight");
    left = place(0), top = place(1), factor = place(2);
    fraction.assign(p.data(), p.data() + p.shape(0));
    for (size_t k = 0; k < weight.count; k++) rim.push_back({rims(k, 0), rims(k, 1), rims(k, 2), rims(k, 3)});
    for (const Rim& one : rim) sigma += std::max(rim_noise(one.blur), 1.0) * SIGMA / double(rim.size());
    exposure_motion = Eigen::Map<const Vector<6>>(motion.data());
}

void FieldsView::require_colours_of(const BallModel& ball) const {
    for (int k : ball.colour)
        if (size_t(std::max(k, 0)) >= weight.count)
            throw nb::type_error("fields: must have one for each colour of ball");
}

Sight::Sight(size_t points) {
    for (auto* v : {&facing, &x, &y, &along, &outward, &scale, &depth, &across, &e, &g}) v->resize(points);
    for (auto* v : {&w, &hidden, &m, &r, &bare_w, &bare_x, &bare_y}) v->resize(points);
    for (auto& v : argument) v.resize(points);
    index.resize(points), bare_index.resize(points);
}

void measure(const BallModel& ball, const FieldsView& fields, const Pose& pose, const double* disc_weight, Sight& s) {
    const Planes weight_field = fields.weight, glare_field = fields.glare;
    const double right = weight_field.width - 1.0, bottom = weight_field.height - 1.0;
    const bool glare = glare_field.count > 0;
    project(ball, pose, fields, s);
    const bool moves = !fields.exposure_motion.isZero(0.0);
    if (moves) blur(ball, pose, fields, s);
    s.disc_weight.resize(ball.first.size());
    for (size_t d = 0; d < ball.first.size(); d++) {  // area in the picture over that of the kernel
        const size_t q = ball.first[d];
        const double scale = s.scale[q],
                     area = std::max(double(s.facing[q]), MIN_FACING) * scale * scale * ball.solid_angle[d];
        s.disc_weight[d] = disc_weight ? disc_weight[d] : std::min(area / KERNEL_AREA, 1.0);
    }
    size_t n = 0, visible = 0;
    s.bare = 0;
    // local pointers, since a store to an array might change a vector's own pointer for all the compiler knows
    size_t* index = s.index.data();
    const float *facing = s.facing.data(), *depth = s.depth.data(), *x = s.x.data(), *y = s.y.data();
    const float* from[7] = {s.along.data(),        s.outward.data(),      facing,
                            s.scale.data(),        ball.column[9].data(), ball.column[10].data(),
                            ball.column[11].data()};
    float* to[9];
    for (int k = 0; k < 9; k++) to[k] = s.argument[k].data();
    double *w = s.w.data(), *m = s.m.data(), *hidden = s.hidden.data();
    for (size_t q = 0; q < ball.size; q++) {  // without a branch, which the processor would mispredict
        index[visible] = q;
        visible += size_t(facing[q] > float(MIN_FACING)) & size_t(depth[q] > 0.0f);
    }
    for (size_t at = 0; at < visible; at++) {
        const size_t q = index[at];
        const double px = x[q], py = y[q];
        if (!(px >= 0.0 && py >= 0.0 && px < right && py < bottom)) continue;
        const double ramp = std::min((double(facing[q]) - MIN_FACING) * (1.0 / (FULL_FACING - MIN_FACING)), 1.0);
        const double veil = glare ? glare_field.at(0, px, py) : 0.0;
        const double weight = ramp * s.disc_weight[size_t(ball.disc[q])] * (1.0 - veil);
        const int k = ball.colour[q];
        if (k < 0) {
            s.bare_index[s.bare] = q, s.bare_w[s.bare] = weight, s.bare_x[s.bare] = px, s.bare_y[s.bare] = py, s.bare++;
            continue;
        }
        m[n] = weight_field.at(k, px, py);
        index[n] = q, w[n] = weight, hidden[n] = veil;
        for (int i = 0; i < 7; i++) to[i][n] = from[i][q];
        const Rim& rim = fields.rim[size_t(k)];
        const float offset = float(rim.offset);
        to[7][n] = moves ? blurred_rim(offset, float(rim.cover), s.across[q]) : offset;
        to[8][n] = float(rim.blur), n++;
    }
    s.coloured = n;
    expect(n, s.argument, s.e.data(), s.g.data());
    for (size_t i = 0; i < n; i++) {
        s.r[i] = s.m[i] - s.e[i];
        if (s.hidden[i] > 0.0 && s.r[i] < 0.0) {  // the field without glare is between m and m plus the glare
            s.r[i] = std::min(s.r[i] + s.hidden[i], 0.0);
            if (s.r[i] == 0.0) s.g[i] = 0.0f;
        }
    }
}

void bind_likelihood(nb::module_& m) {
    nb::class_<BallModel>(m, "BallModel")
        .def(nb::init<nb::handle, nb::handle, double, nb::handle>(), arg("table"), arg("colour"), arg("radius"),
             arg("lens"));
    nb::class_<FieldsView>(m, "FieldsView")
        .def(nb::init<nb::handle, nb::handle, nb::handle, nb::handle, nb::handle, nb::handle>(), arg("weight"),
             arg("glare"), arg("place"), arg("fraction"), arg("rims"), arg("exposure_motion"));
    m.def("log_likelihood", &log_likelihood, arg("position"), arg("rotation"), arg("ball"), arg("fields"), arg("sigma"),
          arg("disc_weight"), arg("which"));
    m.def("evidence_bounds", &evidence_bounds, arg("position"), arg("rotation"), arg("ball"), arg("fields"));
    m.def("expected_field", &expected_field, arg("points"));
}

}  // namespace spheremouse::wand
