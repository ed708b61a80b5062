// Edges of the picture across the ball's predicted outline, and their likelihood. `likelihood.py` has the reasons.
#include "spheremouse/wand/kernels.h"

namespace spheremouse::wand {
namespace {

using Image = Array<const uint8_t, -1, -1, -1>;
using Discs = Array<const double, -1, 4>;
using Edges = Array<const double, -1, DIRECTIONS, 5>;

constexpr int SAMPLES = 25, MIDDLE = 12;  // of a line across the outline, from -6 to 6 px
constexpr int BESIDE = 3;                 // samples from the edge to the colours beside it
constexpr int MAX_DEPTH = 6;              // px inside the outline
constexpr double STEP = 0.5;              // px
constexpr double MIN_STEP = 8.0;          // grey values: above the noise of a mean of nine pixels
constexpr double GAMMA = 2.2;             // of grey values

/// Return the steps inward from the outline point c + d without a rim of a disc, at most 6.
int free_depth(const Pose& pose, const Vector3d& d, const Discs& discs, double radius, double radius_px) {
    int first = -1;
    for (int depth = 0; depth <= MAX_DEPTH; depth++) {
        const double cosine = std::max(1.0 - depth / radius_px, 0.0);
        // the point that many steps inside, towards the camera
        const Vector3d n = cosine * d / radius - std::sqrt(1.0 - cosine * cosine) * pose.c.normalized();
        int label = -1;
        for (size_t q = 0; q < discs.shape(0); q++) {
            const Vector3d u = pose.R * Eigen::Map<const Vector3d>(&discs(q, 0));
            const double angle = std::acos(std::clamp(n.dot(u), -1.0, 1.0)) - discs(q, 3);
            if (std::abs(angle) < 1.0 / radius_px) return depth;  // and one step to the side
            if (angle < 0.0) label = int(q);
        }
        if (depth == 0) first = label;
        if (label != first) return depth;
    }
    return MAX_DEPTH;
}

/// Grey values on a line across the outline, one row for each sample.
struct Line {
    std::vector<double> value[SAMPLES];

    /// Sample a picture bilinearly from `at`, in steps along `by`.
    Line(const Image& image, Vector2d at, const Vector2d& by) {
        for (auto& v : value) {
            const size_t j = size_t(at[0]), l = size_t(at[1]);
            const double a = at[0] - double(j), b = at[1] - double(l);
            for (size_t m = 0; m < image.shape(2); m++)
                v.push_back((1.0 - b) * ((1.0 - a) * image(l, j, m) + a * image(l, j + 1, m)) +
                            b * ((1.0 - a) * image(l + 1, j, m) + a * image(l + 1, j + 1, m)));
            at += by;
        }
    }

    /// Product over the channels of the steps from sample i to j and from k to l.
    double product(int i, int j, int k, int l) const {
        double sum = 0.0;
        for (size_t m = 0; m < value[0].size(); m++) sum += (value[j][m] - value[i][m]) * (value[l][m] - value[k][m]);
        return sum;
    }

    /// Return the place of the edge between the samples `first` and the last, or -1.
    double edge(int first) {
        double best = 0.0;
        int at = -1;
        for (int i = std::max(first, 4); i < SAMPLES - 4; i++) {  // strongest step over four samples, all channels
            const double step = product(i - 2, i + 2, i - 2, i + 2);
            if (step > best) best = step, at = i;
        }
        const int low = at - BESIDE, high = at + BESIDE;
        if (at < 0 || product(low, high, low, high) < MIN_STEP * MIN_STEP) return -1.0;
        // half way between the light inside and outside: light mixes linearly, grey values do not
        for (int i = low; i <= high; i++)
            for (double& v : value[i]) v = std::pow(v * (1.0 / 255.0), GAMMA);
        const double size = product(low, high, low, high);
        double before = 0.0;
        for (int i = low; i <= high; i++) {
            const double part = product(low, i, low, high) / size;
            if (i > low && before < 0.5 && part >= 0.5) return i - 1 + (0.5 - before) / (part - before);
            before = part;
        }
        return -1.0;
    }
};

nb::object measure_edges(nb::handle image_, nb::handle position_, nb::handle rotation_, nb::handle discs_,
                         const BallModel& ball, int factor) {
    const auto image = array<const uint8_t, -1, -1, -1>(image_, "image");
    const auto position = array<const double, 3>(position_, "position");
    const auto rotation = array<const double, 3, 3>(rotation_, "rotation");
    const auto discs = array<const double, -1, 4>(discs_, "discs");
    if (factor < 1) throw nb::value_error("factor: must be positive");
    const Pose pose{Eigen::Map<const Vector3d>(position.data()), Eigen::Map<const Matrix<3>>(rotation.data())};
    const double h = double(image.shape(0)), w = double(image.shape(1)), step = STEP * factor,
                 reach = MIDDLE * step + 1.0;
    const double radius_px = ball.camera.fx * ball.radius / pose.c.norm() / factor;
    const double lower_pole = -std::cos(PI / 4.0) * ball.radius;  // around it a stick or fingers cover the ball
    auto edges = zeros<double>({DIRECTIONS, 5});
    for (size_t k = 0; k < DIRECTIONS; k++) {
        const Vector3d d = outline_point(pose.c, ball.radius, k);
        if (pose.R.col(2).dot(d) < lower_pole) continue;
        const int depth = int(free_depth(pose, d, discs, ball.radius, radius_px) / STEP);
        const int first = std::max(MIDDLE - depth, 0) + BESIDE;
        if (first > MIDDLE - BESIDE) continue;
        const size_t opposite = (k + DIRECTIONS / 2) % DIRECTIONS;  // gives the outward normal
        const Vector2d at = pixel(ball.camera, pose.c + d);
        const Vector2d normal =
            (at - pixel(ball.camera, pose.c + outline_point(pose.c, ball.radius, opposite))).normalized();
        if (!(normal.allFinite() && reach < at[0] && at[0] < w - 1.0 - reach && reach < at[1] &&
              at[1] < h - 1.0 - reach))
            continue;
        const double place = Line(image, at - MIDDLE * step * normal, step * normal).edge(first);
        if (place < 0.0) continue;
        const Vector2d edge = at + (place - MIDDLE) * step * normal;
        const double row[5] = {edge[0], edge[1], normal[0], normal[1], 1.0};
        std::copy(row, row + 5, edges.data() + 5 * k);
    }
    return nb::cast(edges);
}

nb::object outline_log_likelihood(nb::handle position_, nb::handle which_, nb::handle edges_, const BallModel& ball,
                                  int factor) {
    const auto position = array<const double, -1, 3>(position_, "position");
    const auto which = array<const int64_t, -1>(which_, "which");
    const auto edges = array<const double, -1, DIRECTIONS, 5>(edges_, "edges");
    const size_t n = position.shape(0);
    if (which.shape(0) != n) throw nb::type_error("which: must have an index for each pose");
    for (size_t i = 0; i < n; i++)
        if (which(i) < 0 || which(i) >= int64_t(edges.shape(0)))
            throw nb::type_error("which: must be an index of edges");
    auto value = zeros<double>({n});
    double* value_ = value.data();
    const double variance = EDGE_SIGMA * factor * EDGE_SIGMA * factor,
                 prior = EDGE_OFFSET * factor * EDGE_OFFSET * factor;
    nb::gil_scoped_release release;
    for (size_t i = 0; i < n; i++) {
        const Vector3d c = Eigen::Map<const Vector3d>(&position(i, 0));
        double rg = 0.0, gg = 0.0, product = 1.0;  // at least EDGE_HIDDEN to the power of the directions
        for (size_t k = 0; k < DIRECTIONS; k++) {
            const double* edge = &edges(size_t(which(i)), k, 0);
            if (edge[4] == 0.0) continue;
            const Vector2d at = pixel(ball.camera, c + outline_point(c, ball.radius, k));
            const double r = (edge[0] - at[0]) * edge[2] + (edge[1] - at[1]) * edge[3];
            const double seen = (1.0 - EDGE_HIDDEN) * std::exp(-0.5 * r * r / variance) / EDGE_UNIFORM;
            product *= seen + EDGE_HIDDEN;
            rg += seen / (seen + EDGE_HIDDEN) * r;
            gg += seen / (seen + EDGE_HIDDEN);
        }
        const double information = 1.0 / prior + gg / variance, b = rg / variance;  // the common offset, marginalised
        value_[i] = std::log(product) + 0.5 * b * b / information - 0.5 * std::log(information * prior);
    }
    nb::gil_scoped_acquire acquire;
    return nb::cast(value);
}

}  // namespace

Vector3d outline_point(const Vector3d& c, double radius, size_t k) {
    static const auto direction = [] {
        std::vector<Vector2d> u;
        for (size_t i = 0; i < DIRECTIONS; i++) {
            const double angle = 2.0 * PI / double(DIRECTIONS) * double(i);
            u.emplace_back(std::cos(angle), std::sin(angle));
        }
        return u;
    }();
    const Matrix3d B = ray_basis(c);
    const double share = radius * radius / c.squaredNorm();
    return radius * std::sqrt(std::max(1.0 - share, 0.0)) * (B.col(0) * direction[k][0] + B.col(1) * direction[k][1]) -
           share * c;
}

void bind_limb(nb::module_& m) {
    m.def("measure_edges", &measure_edges, arg("image"), arg("position"), arg("rotation"), arg("discs"), arg("ball"),
          arg("factor"));
    m.def("outline_log_likelihood", &outline_log_likelihood, arg("position"), arg("which"), arg("edges"), arg("ball"),
          arg("factor"));
}

}  // namespace spheremouse::wand
