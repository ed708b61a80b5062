// The picture of a ball, learnt from frames at known attitudes, and the pixels that do not turn with the ball.
#include "spheremouse/ball/detect/disc_model.h"
#include "spheremouse/ball/texture/picture.h"

namespace spheremouse::ball {
namespace {

constexpr float FACING = 0.3f;  // cosine between ray and normal from which a place is learnt
constexpr float STATIC_ODDS = -3.0f;
constexpr float APART = 9.0f;           // squared standard deviations from which two explanations differ
constexpr float MOST_PER_FRAME = 3.0f;  // nats: one frame proves little
constexpr float KNOWN = 6.0f;           // views of a cell from which more of them matter little
constexpr int EVERY = 4;                // frames in which a tile that is not known yet is learnt once
constexpr float MOST_ODDS = 12.0f;

/// A frame in which each pixel of a window has a contrast.
struct Shown {
    const float* contrast;  // (h, w)
    int height, width;
    double left, top;  // px, of the window
    double reduction;  // px of the image to one of the window
};

/// Return the contrast at a pixel between others; nan outside.
float between(const Shown& shown, const Vector<2>& uv) {
    const double x = (uv(0) + 0.5 - shown.left) / shown.reduction - 0.5,
                 y = (uv(1) + 0.5 - shown.top) / shown.reduction - 0.5;
    if (!(x >= 0.0 && y >= 0.0 && x < shown.width - 1 && y < shown.height - 1)) return std::nanf("");
    const int i = int(y), j = int(x);
    const float down = float(y - i), right = float(x - j);
    const float *a = shown.contrast + size_t(i) * shown.width + j, *b = a + shown.width;
    const float upper = a[0] + right * (a[1] - a[0]), lower = b[0] + right * (b[1] - b[0]);
    return upper + down * (lower - upper);
}

/// Return true if a tile about the unit direction `d` (obj) may be in view on a picture of n cells.
bool may_be_in_view(const BallView& view, const Vector<3>& d, int n) {
    const double half =
        M_SQRT2 * TILE * HALF / n;  // rad, from its middle to a corner; the cosine changes twice as fast
    const Vector<3> ray = view.centre + view.radius * d - view.position;
    return -d.dot(ray) / ray.norm() > FACING - 2.0 * half;
}

/// A cell in a frame.
struct CellSeen {
    float facing, contrast;  // cosine between ray and normal; nan: not in the window
    bool stands;             // the frame's pixels there stand still
};

CellSeen cell_seen(const Samples& samples, const Shown& shown, const BallView& view, const Vector<3>& d) {
    const Vector<3> ray = view.centre + view.radius * d - view.position;
    CellSeen r{float(-d.dot(ray) / ray.norm()), std::nanf(""), false};
    if (!(r.facing > FACING)) return r;
    const Vector<2> uv = seen_at(view, d);
    const double every = shown.reduction * samples.step;
    const int row = int((uv(1) - shown.top) / every + 0.5), column = int((uv(0) - shown.left) / every + 0.5);
    if (!(row >= 0 && column >= 0 && row < samples.rows && column < samples.columns)) return r;
    r.contrast = between(shown, uv);
    r.stands = samples.odds[row * samples.columns + column] <= STATIC_ODDS;
    return r;
}

/// Learn the cells of a tile from a frame, or forget those that it took from what stands still.
///
/// Return the mean weight in the tile.
float learn_tile(const Picture& picture, const Samples& samples, const Shown& shown, const BallView& view,
                 const Matrix<3>& R, float most, bool forget, int face, int tile_row, int tile_column) {
    float sum = 0.0f;
    for (int i = tile_row * TILE; i < (tile_row + 1) * TILE; i++)
        for (int j = tile_column * TILE; j < (tile_column + 1) * TILE; j++) {
            const size_t at = (size_t(face) * picture.n + i) * picture.n + j;
            float& weight = picture.weight[at];
            const Vector<3> d = R * direction_of(face, float(i), float(j), picture.n).normalized().cast<double>();
            const CellSeen seen = cell_seen(samples, shown, view, d);
            if (forget && seen.stands) weight = 0.0f;
            if (!forget && !seen.stands && std::isfinite(seen.contrast)) {
                const float w = seen.facing * seen.facing;
                picture.value[at] += (seen.contrast - picture.value[at]) * w / (weight + w);
                weight = std::min(weight + w, most);
            }
            sum += weight;
        }
    return sum / float(TILE * TILE);
}

nb::object learn_texture(nb::tuple samples_, nb::tuple picture_, nb::handle known_, nb::handle view_, nb::handle R_,
                         std::tuple<double, double, double> window, double most, int turn, bool forget) {
    const Samples samples = read_samples(samples_);
    const auto contrast = array<const float, -1, -1>(samples_[0], "contrast");
    const Picture picture = read_picture(picture_[0], picture_[1]);
    const auto known = array<float, 6, -1, -1>(known_, "known");
    const int tiles = picture.tiles();
    if (int(known.shape(1)) != tiles || int(known.shape(2)) != tiles)
        throw nb::type_error("known: must have one element for each tile");
    const Shown shown{contrast.data(),     int(contrast.shape(0)), int(contrast.shape(1)),
                      std::get<0>(window), std::get<1>(window),    std::get<2>(window)};
    const BallView view = read_ball_view(view_);
    const Matrix<3> R = matrix<3, 3>(R_, "R");
    int learnt = 0;
    {
        nb::gil_scoped_release release;
        for (int t = 0; t < 6 * tiles * tiles; t++) {
            const int face = t / (tiles * tiles), row = t / tiles % tiles, column = t % tiles;
            const int every = known.data()[t] >= KNOWN ? 32 : EVERY;
            if (turn >= 0 && t % every != turn % every) continue;
            const Vector3f middle =
                direction_of(face, (row + 0.5f) * TILE - 0.5f, (column + 0.5f) * TILE - 0.5f, picture.n).normalized();
            if (!may_be_in_view(view, R * middle.cast<double>(), picture.n)) continue;
            known.data()[t] = learn_tile(picture, samples, shown, view, R, float(most), forget, face, row, column);
            learnt++;
        }
    }
    return nb::cast(learnt);
}

/// Weigh for each sample whether it turns with the ball or stays. `mean` is its mean contrast of late.
///
/// Only a sample for which the two explanations differ says something.
void weigh_static(nb::tuple samples_, nb::tuple picture_, nb::handle R_, nb::handle mean_, nb::handle odds_,
                  double noise, double share, int turn) {
    const Samples samples = read_samples(samples_);
    const Picture picture = read_picture(picture_[0], picture_[1]);
    const Eigen::Matrix3f R = Matrix<3>(matrix<3, 3>(R_, "R")).cast<float>();
    const auto mean = array<float, -1, -1>(mean_, "mean"), odds = array<float, -1, -1>(odds_, "odds");
    for (const auto& each : {mean, odds})
        if (int(each.shape(0)) != samples.rows || int(each.shape(1)) != samples.columns)
            throw nb::type_error("mean, odds: must have the shape of direction");
    const float variance = float(noise * noise);
    for (int i = 0; i < samples.size(); i++) {
        if ((turn >= 0 && i / samples.columns % 4 != turn % 4) || !(samples.direction[3 * size_t(i)] < 2.0f)) continue;
        const float now = samples.at(i);
        float& before = mean.data()[i];
        const Look seen = look(picture, R.transpose() * samples.towards(i));
        if (seen.weight > 0.08f) {
            const float apart = before - seen.value, stays = now - before, turns = now - seen.value;
            if (apart * apart > APART * variance) {
                const float nats = 0.5f * (stays * stays - turns * turns) / variance;
                float& o = odds.data()[i];
                o = std::clamp(o + std::clamp(nats, -MOST_PER_FRAME, MOST_PER_FRAME), -MOST_ODDS, MOST_ODDS);
            }
        }
        before += float(share) * (now - before);
    }
}

}  // namespace

void bind_learn(nb::module_& m) {
    m.def("learn_texture", &learn_texture, arg("samples"), arg("picture"), arg("known"), arg("view"), arg("R"),
          arg("window"), arg("most"), arg("turn"), arg("forget"));
    m.def("weigh_static", &weigh_static, arg("samples"), arg("picture"), arg("R"), arg("mean"), arg("odds"),
          arg("noise"), arg("share"), arg("turn"));
}

}  // namespace spheremouse::ball
