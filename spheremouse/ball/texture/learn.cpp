// The picture of a ball, learnt from frames at known attitudes, and the pixels that do not turn with the ball.
#include "spheremouse/ball/texture/picture.h"

namespace spheremouse::ball {
namespace {

constexpr float FACING = 0.3f;          // cosine between ray and normal from which a place is learnt
constexpr float MOST_PER_FRAME = 3.0f;  // nats: one frame proves little
constexpr float DOUBLE = 2.0f;          // views of a tile, after which it is learnt half as often
constexpr int SELDOM = 8;               // calls in which a known tile is learnt once
constexpr float MOST_ODDS = 12.0f;
constexpr int HEIGHTS = 256;            // steps of the tables from the horizon to the middle
constexpr float MOST_OF_OFFSET = 3.0f;  // standard deviations of a contrast, by which one frame can move the offset

/// Contrast on a chart of the ball (`chart.py`).
///
/// How far from the middle a place is, and how it faces the camera, follow from its height over the plane through the
/// ball's centre across the view. Tables have both from the horizon to the middle.
struct Shown {
    const float* contrast;  // (h, w)
    int height, width;
    float middle;              // px
    Matrix3f axes;             // rows: right and down on the chart, and towards the camera; ball
    float horizon, by_height;  // height of the horizon; steps of the tables by height
    float by_step;             // samples by pixel
    std::array<float, HEIGHTS + 2> scale,
        facing;  // px from the middle, by the sine of the angle; cosine of ray and normal

    /// Set the tables for pixels `spacing` rad apart, and a camera `distance` radii from the centre.
    void set_tables(float spacing, float distance) {
        horizon = 1.0f / distance;
        by_height = HEIGHTS / (1.0f - horizon);
        for (int i = 0; i < HEIGHTS + 2; i++) {
            const float h = std::min(horizon + (1.0f - horizon) * float(i) / HEIGHTS, 1.0f);
            const float sine = std::sqrt(1.0f - h * h);
            scale[i] = (sine > 1e-3f ? std::acos(h) / sine : 1.0f) / spacing;
            facing[i] = (distance * h - 1.0f) / std::sqrt(1.0f + distance * distance - 2.0f * distance * h);
        }
    }
};

/// The cells of a tile in a frame.
struct TileSeen {
    static constexpr int CELLS = TILE * TILE;
    float facing[CELLS];              // cosine between ray and normal; 0: not on the chart
    float right[CELLS], down[CELLS];  // part of the way to the next pixel
    int pixel[CELLS], sample[CELLS];  // the last one before, and the nearest

    /// Find the cells from the directions of one, and of its neighbours less that, in the axes of the chart.
    [[gnu::always_inline]] void find(const Samples& samples, const Shown& shown, const Vector3f& corner,
                                     const Vector3f& below, const Vector3f& beside);
};

inline void TileSeen::find(const Samples& samples, const Shown& shown, const Vector3f& corner, const Vector3f& below,
                           const Vector3f& beside) {
    const float a0 = corner[0], a1 = below[0], a2 = beside[0], b0 = corner[1], b1 = below[1], b2 = beside[1],
                c0 = corner[2], c1 = below[2], c2 = beside[2];
    const float last_x = float(shown.width) - 1.001f, last_y = float(shown.height) - 1.001f, horizon = shown.horizon,
                by_height = shown.by_height, middle = shown.middle, by_step = shown.by_step;
    const int width = shown.width, rows = samples.rows, columns = samples.columns;
    const float *scales = shown.scale.data(), *facings = shown.facing.data();
    for (int k = 0; k < CELLS; k++) {
        const float i = float(k / TILE), j = float(k % TILE);
        const float a = a0 + i * a1 + j * a2, b = b0 + i * b1 + j * b2, c = c0 + i * c1 + j * c2;
        const float inverse = 1.0f / std::sqrt(a * a + b * b + c * c);
        const float height = (c * inverse - horizon) * by_height;
        const int m = std::min(std::max(int(height), 0), HEIGHTS);
        const float part = height - float(m), faces = facings[m] + part * (facings[m + 1] - facings[m]);
        const float scale = inverse * (scales[m] + part * (scales[m + 1] - scales[m]));
        const float x = middle + scale * a, y = middle + scale * b;
        const float u = x > 0.0f ? (x < last_x ? x : last_x) : 0.0f, v = y > 0.0f ? (y < last_y ? y : last_y) : 0.0f;
        const bool on = (height > 0.0f) & (faces > FACING) & (u == x) & (v == y);
        const int column = int(u), row = int(v), near_column = int(u * by_step + 0.5f),
                  near_row = int(v * by_step + 0.5f);
        facing[k] = on ? faces : 0.0f;
        right[k] = u - float(column), down[k] = v - float(row);
        pixel[k] = row * width + column;
        sample[k] = std::min(near_row, rows - 1) * columns + std::min(near_column, columns - 1);
    }
}

/// Learn the cells of a tile from a frame, or forget those that it took from what stands still.
///
/// Return the mean weight in the tile.
WIDE float learn_tile(const Picture& picture, const Samples& samples, const Shown& shown, float most, bool forget,
                      int face, int tile_row, int tile_column) {
    TileSeen seen;
    const float row = float(tile_row * TILE), column = float(tile_column * TILE);
    const Vector3f corner = shown.axes * direction_of(face, row, column, picture.n);
    const Vector3f below = shown.axes * direction_of(face, row + 1.0f, column, picture.n) - corner;
    const Vector3f beside = shown.axes * direction_of(face, row, column + 1.0f, picture.n) - corner;
    seen.find(samples, shown, corner, below, beside);
    float now[TileSeen::CELLS], learns[TileSeen::CELLS];
    int stands[TileSeen::CELLS];
    for (int k = 0; k < TileSeen::CELLS; k++) {
        const float *a = shown.contrast + seen.pixel[k], *b = a + shown.width;
        const float upper = a[0] + seen.right[k] * (a[1] - a[0]), lower = b[0] + seen.right[k] * (b[1] - b[0]);
        now[k] = upper + seen.down[k] * (lower - upper) - samples.offset[seen.sample[k]];
        stands[k] = (seen.facing[k] > 0.0f) & (samples.odds[seen.sample[k]] <= STATIC_ODDS);
        learns[k] = (std::abs(now[k]) < INFINITY) & !stands[k] & !forget ? seen.facing[k] * seen.facing[k] : 0.0f;
    }
    float sum = 0.0f;
    for (int i = 0, k = 0; i < TILE; i++) {
        const size_t at = (size_t(face) * picture.n + tile_row * TILE + i) * picture.n + tile_column * TILE;
        float *value = picture.value + at, *weight = picture.weight + at;
        for (int j = 0; j < TILE; j++, k++) {
            const float before = weight[j], w = learns[k];
            const float after = value[j] + (now[k] - value[j]) * w / (before + w);
            value[j] = w > 0.0f ? after : value[j];
            weight[j] = forget & stands[k] ? 0.0f : before + w < most ? before + w : w > 0.0f ? most : before;
            sum += weight[j];
        }
    }
    return sum / float(TileSeen::CELLS);
}

void learn_texture(nb::tuple samples_, nb::tuple picture_, nb::handle known_, nb::tuple chart, nb::handle R_,
                   double most, int turn, bool forget) {
    const Samples samples = read_samples(samples_);
    const auto contrast = array<const float, -1, -1>(samples_[0], "contrast");
    const Picture picture = read_picture(picture_);
    const auto known = array<float, 6, -1, -1>(known_, "known");
    const int tiles = picture.tiles();
    if (int(known.shape(1)) != tiles || int(known.shape(2)) != tiles)
        throw nb::type_error("known: must have one element for each tile");
    members(chart, 4, "chart");
    Shown shown{};
    shown.contrast = contrast.data();
    shown.height = int(contrast.shape(0));
    shown.width = int(contrast.shape(1));
    shown.middle = 0.5f * float(number<int>(chart[2], "size") - 1);
    shown.axes = (Matrix<3>(matrix<3, 3>(chart[0], "axes")) * matrix<3, 3>(R_, "R")).cast<float>();
    shown.by_step = 1.0f / float(samples.step);
    shown.set_tables(number<float>(chart[1], "spacing"), number<float>(chart[3], "distance"));
    const float reach = float(M_SQRT2) * TILE * HALF / float(picture.n);  // rad, from the middle of a tile to a corner
    nb::gil_scoped_release release;
    for (int t = 0; t < 6 * tiles * tiles; t++) {
        int every = 1;
        for (float views = DOUBLE; known.data()[t] >= views && every < SELDOM; views += DOUBLE) every *= 2;
        if (turn >= 0 && t % every != turn % every) continue;
        const int face = t / (tiles * tiles), row = t / tiles % tiles, column = t % tiles;
        const Vector3f middle =
            direction_of(face, (row + 0.5f) * TILE - 0.5f, (column + 0.5f) * TILE - 0.5f, picture.n);
        if (!(shown.axes.row(2).dot(middle.normalized()) > shown.horizon - reach)) continue;
        known.data()[t] = learn_tile(picture, samples, shown, float(most), forget, face, row, column);
    }
}

/// Weigh for each sample whether it turns with the ball or stays. `mean` is its mean contrast of late.
///
/// Only a sample for which the two explanations differ says something. What the turning picture leaves unexplained in
/// the mean is the contrast of light, `offset`, of which a frame has the share `settle`.
void weigh_static(nb::tuple samples_, nb::tuple picture_, nb::handle R_, nb::tuple after, double noise, double share,
                  double settle, double apart_) {
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_);
    const Eigen::Matrix3f R = Matrix<3>(matrix<3, 3>(R_, "R")).cast<float>();
    members(after, 3, "after");
    const auto mean = array<float, -1, -1>(after[0], "mean"), odds = array<float, -1, -1>(after[1], "odds"),
               offset = array<float, -1, -1>(after[2], "offset");
    for (const auto& each : {mean, odds, offset})
        if (int(each.shape(0)) != samples.rows || int(each.shape(1)) != samples.columns)
            throw nb::type_error("mean, odds, offset: must have the shape of direction");
    const float variance = float(noise * noise), least = float(apart_ * apart_) * variance,
                limit = MOST_OF_OFFSET * float(noise);
    const Pixels pixels = pixels_on_ball(samples, -INFINITY);
    Look seen;
    for (size_t first = 0; first < pixels.size(); first += Look::MOST) {
        seen.at(picture, R.transpose(), pixels, first);
        for (size_t k = 0; k < seen.size; k++) {
            const int i = pixels.sample[first + k];
            float &before = mean.data()[i], &light = offset.data()[i], &o = odds.data()[i];
            const float now = pixels.contrast[first + k], apart = before - seen.value[k], stays = now - before,
                        turns = now - seen.value[k];
            const bool known = seen.weight[k] > LEAST_WEIGHT;
            const float nats = 0.5f * (stays * stays - turns * turns) / variance;
            const float after =
                std::clamp(o + std::clamp(nats, -MOST_PER_FRAME, MOST_PER_FRAME), -MOST_ODDS, MOST_ODDS);
            if (known && apart * apart > least) o = after;
            if (known && std::isfinite(turns)) light += float(settle) * std::clamp(turns, -limit, limit);
            before += float(share) * stays;
        }
    }
}

/// Return the log odds of the samples, once -inf for a detail and once for any sample that may stand still.
///
/// That is a sample whose contrast differs by less than `change` from that of the `first` frame, while its own odds,
/// `own`, do not prove that it turns.
nb::tuple leave_out_doubtful(nb::tuple samples_, nb::handle first_, nb::handle own_, double change, double detail) {
    const Samples samples = read_samples(samples_);
    const auto first = array<const float, -1, -1>(first_, "first"), own = array<const float, -1, -1>(own_, "own");
    for (const auto& each : {first, own})
        if (int(each.shape(0)) != samples.rows || int(each.shape(1)) != samples.columns)
            throw nb::type_error("first, own: must have the shape of direction");
    const size_t rows = size_t(samples.rows), columns = size_t(samples.columns);
    auto counts = zeros<float>({rows, columns}), turning = zeros<float>({rows, columns});
    const float differs = float(change), shows = float(detail);
    for (size_t row = 0, i = 0; row < rows; row++) {
        const float* contrast = samples.contrast + row * size_t(samples.step) * size_t(samples.width);
        for (size_t column = 0; column < columns; column++, i++, contrast += samples.step) {
            const bool same = (std::abs(*contrast - first.data()[i]) < differs) & (own.data()[i] < -STATIC_ODDS);
            turning.data()[i] = same ? -INFINITY : samples.odds[i];
            counts.data()[i] = same & (std::abs(*contrast) > shows) ? -INFINITY : samples.odds[i];
        }
    }
    return nb::make_tuple(counts, turning);
}

}  // namespace

void bind_learn(nb::module_& m) {
    m.attr("TILE") = TILE;
    m.attr("LEAST_WEIGHT") = LEAST_WEIGHT;
    m.attr("STATIC_ODDS") = STATIC_ODDS;
    m.attr("FACING") = FACING;
    m.def("learn_texture", &learn_texture, arg("samples"), arg("picture"), arg("known"), arg("chart"), arg("R"),
          arg("most"), arg("turn"), arg("forget"));
    m.def("leave_out_doubtful", &leave_out_doubtful, arg("samples"), arg("first"), arg("own"), arg("change"),
          arg("detail"));
    m.def("weigh_static", &weigh_static, arg("samples"), arg("picture"), arg("R"), arg("after"), arg("noise"),
          arg("share"), arg("settle"), arg("apart"));
}

}  // namespace spheremouse::ball
