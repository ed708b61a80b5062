// The picture of a ball, learnt from frames at known attitudes, and the pixels that do not turn with the ball.
#include "spheremouse/ball/texture/picture.h"

namespace spheremouse::ball {
namespace {

constexpr float FACING = 0.3f;          // cosine between ray and normal from which a place is learnt
constexpr float MOST_PER_FRAME = 3.0f;  // nats: one frame proves little
constexpr float MOST_ODDS = 12.0f;
constexpr int HEIGHTS = 256;            // steps of the tables from the horizon to the middle
constexpr float MOST_OF_OFFSET = 3.0f;  // standard deviations of a contrast, by which one frame can move the offset

/// Contrast on a chart of the ball (`chart.py`).
///
/// How far from the middle a place is, and how it faces the camera, follow from its height over the plane through the
/// ball's centre across the view. Tables have both from the horizon to the middle.
struct Shown {
    const float* contrast;  // (height, width)
    int height, width;
    const float* still;  // (rows, columns) contrast that stands still in the sample there; nan: it shows no part
                         // of the ball that turns
    int rows, columns;
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
    [[gnu::always_inline]] void find(const Shown& shown, const Vector3f& corner, const Vector3f& below,
                                     const Vector3f& beside);
};

inline void TileSeen::find(const Shown& shown, const Vector3f& corner, const Vector3f& below, const Vector3f& beside) {
    const float a0 = corner[0], a1 = below[0], a2 = beside[0], b0 = corner[1], b1 = below[1], b2 = beside[1],
                c0 = corner[2], c1 = below[2], c2 = beside[2];
    const float last_x = float(shown.width) - 1.001f, last_y = float(shown.height) - 1.001f, horizon = shown.horizon,
                by_height = shown.by_height, middle = shown.middle, by_step = shown.by_step;
    const int width = shown.width, rows = shown.rows, columns = shown.columns;
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
WIDE float learn_tile(const Picture& picture, const Shown& shown, float most, bool forget, int face, int tile_row,
                      int tile_column) {
    TileSeen seen;
    const float row = float(tile_row * TILE), column = float(tile_column * TILE);
    const Vector3f corner = shown.axes * direction_of(face, row, column, picture.n);
    const Vector3f below = shown.axes * direction_of(face, row + 1.0f, column, picture.n) - corner;
    const Vector3f beside = shown.axes * direction_of(face, row, column + 1.0f, picture.n) - corner;
    seen.find(shown, corner, below, beside);
    float now[TileSeen::CELLS], learns[TileSeen::CELLS];
    int stands[TileSeen::CELLS];
    for (int k = 0; k < TileSeen::CELLS; k++) {
        const float *a = shown.contrast + seen.pixel[k], *b = a + shown.width;
        const float upper = a[0] + seen.right[k] * (a[1] - a[0]), lower = b[0] + seen.right[k] * (b[1] - b[0]);
        const float still = shown.still[seen.sample[k]];
        now[k] = upper + seen.down[k] * (lower - upper) - still;
        stands[k] = (seen.facing[k] > 0.0f) & (still != still);
        learns[k] = (std::abs(now[k]) < INFINITY) & !forget ? seen.facing[k] * seen.facing[k] : 0.0f;
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

void learn_texture(nb::tuple seen, nb::tuple picture_, nb::handle which_, nb::tuple chart, nb::handle R_, double most,
                   bool forget) {
    members(seen, 5, "seen");
    const auto contrast = array<const float, -1, -1>(seen[0], "contrast");
    const auto number_of = array<const int32_t, -1, -1>(seen[1], "number");
    const auto odds = array<const float, -1>(seen[2], "odds"), offset = array<const float, -1>(seen[3], "offset");
    const int step = number<int>(seen[4], "step");
    if (offset.size() != odds.size()) throw nb::type_error("offset: must have the length of odds");
    if (contrast.shape(0) < 2 || contrast.shape(1) < 2) throw nb::type_error("contrast: must have two rows and columns");
    if (number_of.size() == 0) throw nb::type_error("number: must have pixels");
    if (step < 1) throw nb::index_error("step: must be 1 or more");
    std::vector<float> still(number_of.size(), NAN);
    for (size_t i = 0; i < still.size(); i++) {
        const int sample = number_of.data()[i];
        if (sample >= int(odds.size())) throw nb::index_error("number: no such sample");
        if (sample >= 0 && odds.data()[sample] > STATIC_ODDS) still[i] = offset.data()[sample];
    }
    members(picture_, 3, "picture");
    const Picture picture = read_picture(nb::make_tuple(picture_[0], picture_[1]));
    const auto known = array<float, 6, -1, -1>(picture_[2], "known");
    const int tiles = picture.tiles();
    if (int(known.shape(1)) != tiles || int(known.shape(2)) != tiles)
        throw nb::type_error("known: must have one element for each tile");
    const auto which = array<const int64_t, -1>(which_, "tiles");
    for (size_t i = 0; i < which.size(); i++)
        if (which.data()[i] < 0 || which.data()[i] >= 6 * tiles * tiles) throw nb::index_error("tiles: no such tile");
    members(chart, 4, "chart");
    Shown shown{};
    shown.contrast = contrast.data();
    shown.height = int(contrast.shape(0)), shown.width = int(contrast.shape(1));
    shown.still = still.data();
    shown.rows = int(number_of.shape(0)), shown.columns = int(number_of.shape(1));
    shown.middle = 0.5f * (float(number<int>(chart[2], "size")) - 1.0f);
    shown.axes = (Matrix<3>(matrix<3, 3>(chart[0], "axes")) * matrix<3, 3>(R_, "R")).cast<float>();
    shown.by_step = 1.0f / float(step);
    shown.set_tables(number<float>(chart[1], "spacing"), number<float>(chart[3], "distance"));
    nb::gil_scoped_release release;
    for (size_t i = 0; i < which.size(); i++) {
        const int t = int(which.data()[i]);
        known.data()[t] =
            learn_tile(picture, shown, float(most), forget, t / (tiles * tiles), t / tiles % tiles, t % tiles);
    }
}

/// How samples are weighed.
struct Weighing {
    float variance;  // of a contrast
    float share;     // of a frame in the mean contrast
    float settle;    // of a frame in the contrast of light
    float least;     // squared difference of the two explanations, from which a sample tells
    float limit;     // of what a frame shows of the contrast of light
};

/// Weigh samples that are seen before the picture; `mean`, `odds` and `light` are updated.
WIDE void weigh(const Look& seen, const float* contrast, const Weighing& by, float* __restrict mean,
                float* __restrict odds, float* __restrict light) {
    for (size_t i = 0; i < seen.size; i++) {
        const float now = contrast[i] - light[i], apart = mean[i] - seen.value[i], stays = now - mean[i],
                    turns = now - seen.value[i];
        const bool known = seen.weight[i] > LEAST_WEIGHT;
        const float nats = 0.5f * (stays * stays - turns * turns) / by.variance;
        const float limited = std::min(std::max(nats, -MOST_PER_FRAME), MOST_PER_FRAME);
        const float after = std::min(std::max(odds[i] + limited, -MOST_ODDS), MOST_ODDS);
        const float rest = light[i] + by.settle * std::min(std::max(turns, -by.limit), by.limit);
        odds[i] = known & (apart * apart > by.least) ? after : odds[i];
        light[i] = known & (std::abs(turns) < INFINITY) ? rest : light[i];
        mean[i] += by.share * stays;
    }
}

/// Weigh for each sample whether it turns with the ball or stays. `mean` is its mean contrast of late.
///
/// Only a sample for which the two explanations differ says something. What the turning picture leaves unexplained in
/// the mean is the contrast of light, `offset`, of which a frame has the share `settle`.
void weigh_static(nb::tuple samples_, nb::tuple picture_, nb::handle R_, nb::tuple after, double noise, double share,
                  double settle, double apart) {
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_);
    const Eigen::Matrix3f towards = Matrix<3>(matrix<3, 3>(R_, "R").transpose()).cast<float>();
    members(after, 3, "after");
    const auto mean = array<float, -1>(after[0], "mean"), odds = array<float, -1>(after[1], "odds"),
               offset = array<float, -1>(after[2], "offset");
    for (const auto& each : {mean, odds, offset})
        if (each.size() != samples.size) throw nb::type_error("mean, odds, offset: must have the length of contrast");
    const float variance = float(noise * noise);
    const Weighing by{variance, float(share), float(settle), float(apart * apart) * variance,
                      MOST_OF_OFFSET * float(noise)};
    nb::gil_scoped_release release;
    Look seen;
    for (size_t i = 0; i < samples.size; i += Look::MOST) {
        seen.at(picture, towards, samples.x + i, samples.y + i, samples.z + i, samples.size - i);
        weigh(seen, samples.contrast + i, by, mean.data() + i, odds.data() + i, offset.data() + i);
    }
}

WIDE void mark_doubtful(const Samples& samples, const float* first, const float* own, float change, float detail,
                        float* __restrict counts, float* __restrict turning) {
    for (size_t i = 0; i < samples.size; i++) {
        const float contrast = samples.contrast[i], odds = samples.odds[i];
        const bool same = (std::abs(contrast - first[i]) < change) & (own[i] < -STATIC_ODDS);
        turning[i] = same ? -INFINITY : odds;
        counts[i] = same & (std::abs(contrast) > detail) ? -INFINITY : odds;
    }
}

/// Return the log odds of the samples, once -inf for a detail and once for any sample that may stand still.
///
/// That is a sample whose contrast differs by less than `change` from that of the `first` frame, while its own odds,
/// `own`, do not prove that it turns.
nb::tuple leave_out_doubtful(nb::tuple samples_, nb::handle first_, nb::handle own_, double change, double detail) {
    const Samples samples = read_samples(samples_);
    const auto first = array<const float, -1>(first_, "first"), own = array<const float, -1>(own_, "own");
    for (const auto& each : {first, own})
        if (each.size() != samples.size) throw nb::type_error("first, own: must have the length of contrast");
    auto counts = zeros<float>({samples.size}), turning = zeros<float>({samples.size});
    {
        nb::gil_scoped_release release;
        mark_doubtful(samples, first.data(), own.data(), float(change), float(detail), counts.data(), turning.data());
    }
    return nb::make_tuple(counts, turning);
}

}  // namespace

void bind_learn(nb::module_& m) {
    m.attr("TILE") = TILE;
    m.attr("LEAST_WEIGHT") = LEAST_WEIGHT;
    m.attr("STATIC_ODDS") = STATIC_ODDS;
    m.attr("FACING") = FACING;
    m.def("learn_texture", &learn_texture, arg("seen"), arg("picture"), arg("tiles"), arg("chart"), arg("R"),
          arg("most"), arg("forget"));
    m.def("leave_out_doubtful", &leave_out_doubtful, arg("samples"), arg("first"), arg("own"), arg("change"),
          arg("detail"));
    m.def("weigh_static", &weigh_static, arg("samples"), arg("picture"), arg("R"), arg("after"), arg("noise"),
          arg("share"), arg("settle"), arg("apart"));
}

}  // namespace spheremouse::ball
