// Search for unknown discs in a part of a picture, as `search.py` describes it.
#include "spheremouse/ball/detect/disc_model.h"

namespace spheremouse::ball {
namespace {

using Places = Array<const double, -1, 2>;

constexpr size_t MAX_FOUND = 4;      // candidates in one frame: more come in the next
constexpr double REJECTED = 2.5;     // px of the coarse picture, around a place that turned out to be no disc
constexpr int SIDES = 8;             // neighbours, opposite ones follow each other
constexpr int MIN_BRIGHTER = 4;      // neighbours
constexpr size_t OTHER_START = 997;  // each frame begins elsewhere, so the limit falls on no disc for long

/// Values of a projection: those of one channel, with a sign, less the value of no light.
struct Plane {
    Image image;
    Mask mask;
    int sign, dark;
    const uint8_t* first;  // of the channel
    int width, height, channels;
    size_t size;  // from that one to the last

    Plane(Image image_, Mask mask_, size_t channel, int sign_, int dark_)
        : image(image_),
          mask(mask_),
          sign(sign_),
          dark(dark_),
          first(image.data() + channel),
          width(int(image.shape(1))),
          height(int(image.shape(0))),
          channels(int(image.shape(2))),
          size(image.size() > channel ? image.size() - channel : 0) {
        if (image.shape(0) != mask.shape(0) || image.shape(1) != mask.shape(1))
            throw nb::type_error("mask: must have the size of image");
        if (channel >= image.shape(2)) throw nb::value_error("plane: its channel must be in image");
        if ((sign != 1 && sign != -1) || dark < -255 || dark > 255)
            throw nb::value_error("plane: must have a sign of 1 or -1, and no light from -255 to 255");
    }

    ptrdiff_t index(int x, int y) const { return (ptrdiff_t(y) * width + x) * channels; }

    int at(ptrdiff_t index) const {
        if (size_t(index) >= size) throw nb::value_error("samples: must lie in image, with their neighbours");
        return sign * first[index] - dark;
    }
};

/// Pixels of a lattice, `search.Samples`.
struct Samples {
    size_t size;
    const int32_t *place, *along;
    const uint8_t* sides;
    ptrdiff_t step[SIDES];  // to the neighbours, in a Plane
};

struct Limits {
    int keep;  // of 256 parts of the lighter of disc and ball: the darker one has less
    int least;
    double radius;  // px, of the largest disc
    int reduction;

    /// Return true if a value is darker than its neighbour by a part of the lighter of the two, whatever their signs.
    bool darker(int value, int beside) const { return 256 * value < keep * beside && keep * value < 256 * beside; }
    bool clearly_darker(int value, int beside) const { return darker(value, beside) && value < beside - least; }
};

template <class P>
bool is_near(const Vector<2>& at, const P& places, size_t count, double radius) {
    for (size_t i = 0; i < count; i++)
        if ((at - View<2, 1>(&places(i, 0))).squaredNorm() < radius * radius) return true;
    return false;
}

/// Return the level between a sample and the ball around it, or nothing unless it is darker on nearly all sides.
bool is_dark_spot(const Plane& plane, const Samples& samples, size_t i, const Limits& limits, float& level) {
    const ptrdiff_t at = plane.index(samples.place[2 * i], samples.place[2 * i + 1]);
    const int bits = samples.sides[i], value = plane.at(at);
    // two neighbours part most of the ball from the rest
    if ((bits & 3) == 3 &&
        !limits.darker(value, std::max(plane.at(at + samples.step[0]), plane.at(at + samples.step[1]))))
        return false;
    int brighter = 0, others = 0, ball = 0;
    for (int k = 0; k < SIDES && others < 2; k++) {
        if (!((bits >> k) & 1)) continue;
        const int beside = plane.at(at + samples.step[k]);
        if (limits.clearly_darker(value, beside))
            brighter++, ball += beside;
        else
            others++;
    }
    if (others > 1 || brighter < MIN_BRIGHTER) return false;
    for (size_t k = 0; k < 2; k++) {  // a disc ends along the limb, the limb's own blur does not
        const int u = samples.along[4 * i + 2 * k], v = samples.along[4 * i + 2 * k + 1];
        if ((u != 0 || v != 0) && !limits.clearly_darker(value, plane.at(at + plane.index(u, v)))) return false;
    }
    level = float(0.5 * (value + double(ball) / brighter));
    return true;
}

/// Take two mean-shift steps towards the pixels darker than `level`, on the ball, within `reach` px.
Vector<2> settle(const Plane& plane, float level, double reach, int step, Vector<2> at) {
    for (int round = 0; round < 2; round++) {
        const int left = int(std::max(at(0) - reach, 0.0)),
                  right = int(std::min(at(0) + reach + 1.0, plane.width - 1.0));
        const int top = int(std::max(at(1) - reach, 0.0)),
                  bottom = int(std::min(at(1) + reach + 1.0, plane.height - 1.0));
        float total = 0.0f, sx = 0.0f, sy = 0.0f;
        for (int y = top; y <= bottom; y += step)
            for (int x = left; x <= right; x += step) {
                const float value = float(plane.at(plane.index(x, y)));
                const double dx = x - at(0), dy = y - at(1);
                if (value < level && plane.mask(size_t(y), size_t(x)) > 0 && dx * dx + dy * dy < reach * reach) {
                    total += level - value;
                    sx += (level - value) * float(x);
                    sy += (level - value) * float(y);
                }
            }
        if (!(total > 0.0f)) break;
        at = Vector<2>(sx / total, sy / total);
    }
    return at;
}

std::vector<Vector<2>> find(const Plane& plane, const Samples& samples, const Limits& limits, int64_t turn,
                            const Places& known, const Places& rejected) {
    const double known_radius = limits.radius + 2.0 * limits.reduction;
    std::vector<Vector<2>> found;
    const auto in_found = [&](size_t i, int axis) -> const double& { return found[i](axis); };
    const size_t n = samples.size, start = n ? size_t(turn) * OTHER_START % n : 0;
    for (size_t k = 0; k < n && found.size() < MAX_FOUND; k++) {
        const size_t i = start + k < n ? start + k : start + k - n;
        float level;
        if (!is_dark_spot(plane, samples, i, limits, level)) continue;
        Vector<2> at(samples.place[2 * i], samples.place[2 * i + 1]);
        if (is_near(at, known, known.shape(0), known_radius) || is_near(at, in_found, found.size(), known_radius) ||
            is_near(at, rejected, rejected.shape(0), 0.7 * limits.radius))  // within such a place
            continue;
        at = settle(plane, level, limits.radius + limits.reduction, limits.reduction, at);
        if (!is_near(at, known, known.shape(0), known_radius) &&
            !is_near(at, rejected, rejected.shape(0), REJECTED * limits.reduction))
            found.push_back(at);
    }
    return found;
}

Limits read_limits(nb::handle given) {
    const nb::tuple limits = members(given, 4, "limits");
    double value[3];
    for (int i = 0; i < 3; i++) value[i] = number<double>(limits[i], "limits");
    const auto [contrast, difference, radius] = value;
    const int reduction = number<int>(limits[3], "limits");
    if (!(std::abs(contrast) <= 1.0 && std::abs(difference) < 1e6 && std::abs(radius) < 1e6) || reduction < 1 ||
        reduction > 1000)
        throw nb::value_error("limits: must be finite, with a contrast up to 1 and a reduction from 1 to 1000");
    return {int(256.0 * (1.0 - contrast)), int(difference), radius, reduction};
}

nb::object candidate_pixels(nb::handle plane_, nb::handle mask, nb::handle samples_, nb::handle offsets,
                            nb::handle limits_, int64_t turn, nb::handle known_, nb::handle rejected_) {
    const nb::tuple source = members(plane_, 4, "plane"), lattice = members(samples_, 3, "samples");
    const Plane plane(array<const uint8_t, -1, -1, -1>(source[0], "image"), array<const uint8_t, -1, -1>(mask, "mask"),
                      number<size_t>(source[1], "plane"), number<int>(source[2], "plane"),
                      number<int>(source[3], "plane"));
    const auto place = array<const int32_t, -1, 2>(lattice[0], "place");
    const auto sides = array<const uint8_t, -1>(lattice[1], "sides");
    const auto along = array<const int32_t, -1, 2, 2>(lattice[2], "along");
    const auto steps = array<const int32_t, SIDES, 2>(offsets, "offsets");
    Samples samples{place.shape(0), place.data(), along.data(), sides.data(), {}};
    for (size_t k = 0; k < SIDES; k++) samples.step[k] = plane.index(steps(k, 0), steps(k, 1));
    if (sides.shape(0) != samples.size || along.shape(0) != samples.size)
        throw nb::type_error("sides, along: must have the length of place");
    const Limits limits = read_limits(limits_);
    const auto known = array<const double, -1, 2>(known_, "known"),
               rejected = array<const double, -1, 2>(rejected_, "rejected");
    if (turn < 0) throw nb::value_error("turn: must not be negative");
    std::vector<Vector<2>> found;
    {
        nb::gil_scoped_release release;
        found = find(plane, samples, limits, turn, known, rejected);
    }
    const Rows<2> places(found.size());
    for (size_t i = 0; i < found.size(); i++) places[i] = found[i];
    return nb::cast(places.array);
}

}  // namespace

void bind_search(nb::module_& m) {
    m.def("candidate_pixels", &candidate_pixels, arg("plane"), arg("mask"), arg("samples"), arg("offsets"),
          arg("limits"), arg("turn"), arg("known"), arg("rejected"));
}

}  // namespace spheremouse::ball
