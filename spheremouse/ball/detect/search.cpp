// Search for unknown discs in a part of a picture, as `search.py` describes it.
#include <array>
#include <optional>

#include "spheremouse/ball/detect/disc_model.h"

namespace spheremouse::ball {
namespace {

constexpr size_t MAX_FOUND = 4;           // candidates in one frame: more come in the next
constexpr double REJECTED = 2.5;          // px of the coarse picture, around a place that was no disc
constexpr double WAIT[] = {32.0, 512.0};  // turns for which it is left out, at first and at most
constexpr size_t REMEMBERED = 256;        // such places
constexpr int SIDES = 8;                  // neighbours, opposite ones follow each other
constexpr int MIN_BRIGHTER = 4;           // neighbours
constexpr size_t OTHER_START = 997;       // each frame begins elsewhere, so the limit falls on no disc for long
constexpr size_t AHEAD = 256;             // samples that come from memory before their turn
constexpr float GREY[] = {0.114f, 0.587f, 0.299f};  // `projection.GREY`

using Points = std::vector<Vector<2>>;

/// Pixels of a lattice, `search.Samples`, and its other data.
struct Lattice {
    size_t size;
    const int32_t *place, *along;
    const uint8_t* sides;
    ptrdiff_t step[SIDES];  // to the neighbours, in a picture
    int reduction;
};

/// A place that turned out to be no disc.
struct Rejection {
    Vector<2> place;  // px
    double until;     // turn, left out before
    double wait;      // turns for which it was left out last
};

struct Search {
    int64_t turn;
    Common discs;
    double sample_noise;
    std::vector<Rejection> rejected;
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

/// Values of the samples (`projection.sample_weights_of`): of grey, green alone.
class Plane {
    const uint8_t* first_;
    size_t size_;  // from a pixel to the last one
    ptrdiff_t channels_;
    std::array<float, 3> w_;
    int single_ = -1, sign_ = 1;  // the only channel with a weight, and its sign

  public:
    Mask mask;
    int width, height;

    explicit Plane(const Photo& photo)
        : first_(photo.image.data()),
          size_(photo.image.size() - photo.image.shape(2) + 1),
          channels_(ptrdiff_t(photo.image.shape(2))),
          w_{photo.weights[0], photo.weights[1], photo.weights[2]},
          mask(photo.mask),
          width(int(mask.shape(1))),
          height(int(mask.shape(0))) {
        if (channels_ == 1) w_[1] = w_[2] = 0.0f;
        const auto has_size = [](float w, float grey) { return std::abs(w) == grey; };
        if (std::equal(w_.begin(), w_.end(), GREY, has_size)) w_ = {0.0f, std::copysign(1.0f, w_[1]), 0.0f};
        for (int c = 0; c < 3; c++)
            if (std::abs(w_[size_t(c)]) == 1.0f) single_ = c, sign_ = int(w_[size_t(c)]);
    }

    ptrdiff_t index(int64_t x, int64_t y) const { return (y * width + x) * channels_; }
    void prefetch(ptrdiff_t index) const { __builtin_prefetch(first_ + index); }

    int at(ptrdiff_t index) const {
        if (size_t(index) >= size_) throw nb::value_error("samples: must lie in image, with their neighbours");
        const uint8_t* p = first_ + index;
        if (single_ >= 0) return sign_ * p[single_];
        constexpr int LOWEST = -1000;  // below all sums, which are rounded
        return int(w_[0] * float(p[0]) + w_[1] * float(p[1]) + w_[2] * float(p[2]) + 0.5f - LOWEST) + LOWEST;
    }
};

template <class P>
bool is_near(const Vector<2>& at, const P& places, double radius) {
    return std::any_of(places.begin(), places.end(),
                       [&](const auto& place) { return (at - place).squaredNorm() < radius * radius; });
}

/// Return the level between a sample and the ball around it, or nothing unless it is darker on nearly all sides.
std::optional<float> dark_level(const Plane& plane, const Lattice& lattice, size_t i, const Limits& limits) {
    const ptrdiff_t at = plane.index(lattice.place[2 * i], lattice.place[2 * i + 1]);
    const int value = plane.at(at);
    int brighter = 0, others = 0, ball = 0;
    for (size_t k = 0; k < SIDES && others < 2; k++) {
        if (!((lattice.sides[i] >> k) & 1)) continue;
        const int beside = plane.at(at + lattice.step[k]);
        if (limits.clearly_darker(value, beside))
            brighter++, ball += beside;
        else
            others++;
    }
    if (others > 1 || brighter < MIN_BRIGHTER) return {};
    for (size_t k = 0; k < 2; k++) {  // a disc ends along the limb, the limb's own blur does not
        const int u = lattice.along[4 * i + 2 * k], v = lattice.along[4 * i + 2 * k + 1];
        if ((u != 0 || v != 0) && !limits.clearly_darker(value, plane.at(at + plane.index(u, v)))) return {};
    }
    return float(0.5 * (value + double(ball) / brighter));
}

/// Return false if no neighbour in the row is brighter: they part most of the ball from the rest.
inline bool is_possible(const Plane& plane, const Lattice& lattice, size_t i, const Limits& limits) {
    if ((lattice.sides[i] & 3) != 3) return true;
    const ptrdiff_t at = plane.index(lattice.place[2 * i], lattice.place[2 * i + 1]);
    return limits.darker(plane.at(at), std::max(plane.at(at + lattice.step[0]), plane.at(at + lattice.step[1])));
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

/// Return the samples that `is_possible` leaves. Their other neighbours come from memory meanwhile.
std::vector<size_t> possible_samples(const Plane& plane, const Lattice& lattice, const Limits& limits, int64_t turn) {
    std::vector<size_t> possible;
    const size_t n = lattice.size, start = n ? size_t(turn) * OTHER_START % n : 0;
    possible.reserve(n);
    for (size_t k = 0; k < n; k++) {
        const size_t i = start + k < n ? start + k : start + k - n, ahead = std::min(i + AHEAD, n - 1);
        if (k % 8 == 0) plane.prefetch(plane.index(lattice.place[2 * ahead], lattice.place[2 * ahead + 1]));
        if (!is_possible(plane, lattice, i, limits)) continue;
        const ptrdiff_t at = plane.index(lattice.place[2 * i], lattice.place[2 * i + 1]);
        for (size_t side = 2; side < SIDES; side++) plane.prefetch(at + lattice.step[side]);
        possible.push_back(i);
    }
    return possible;
}

/// Return dark spots on the ball, away from the places `known`: centroids of the dark pixels around a sample.
Points find(const Plane& plane, const Lattice& lattice, const Limits& limits, const Search& search,
            const Points& known) {
    const double known_radius = limits.radius + 2.0 * limits.reduction;
    Points found, rejected;
    for (const Rejection& r : search.rejected)
        if (r.until > double(search.turn)) rejected.push_back(r.place);
    for (const size_t i : possible_samples(plane, lattice, limits, search.turn)) {
        if (found.size() >= MAX_FOUND) break;
        const std::optional<float> level = dark_level(plane, lattice, i, limits);
        if (!level) continue;
        Vector<2> at(lattice.place[2 * i], lattice.place[2 * i + 1]);
        if (is_near(at, known, known_radius) || is_near(at, found, known_radius) ||
            is_near(at, rejected, 0.7 * limits.radius))  // within such a place
            continue;
        at = settle(plane, *level, limits.radius + limits.reduction, limits.reduction, at);
        if (!is_near(at, known, known_radius) && !is_near(at, rejected, REJECTED * limits.reduction))
            found.push_back(at);
    }
    return found;
}

/// Begin the next turn after a frame that rejected some places as discs. A place without a new sighting expires.
void next_turn(Search& search, const Points& rejected, int reduction) {
    const double turn = double(++search.turn), radius = REJECTED * reduction;
    if (rejected.empty()) return;
    std::vector<Rejection> next;
    for (const Vector<2>& place : rejected)
        if (std::none_of(search.rejected.begin(), search.rejected.end(),
                         [&](const Rejection& r) { return (r.place - place).norm() < radius; }))
            next.push_back({place, turn + WAIT[0], WAIT[0]});
    for (Rejection r : search.rejected) {
        if (is_near(r.place, rejected, radius)) {
            r.wait = std::min(2.0 * r.wait, WAIT[1]);
            r.until = turn + r.wait;
        }
        if (turn - r.until < r.wait) next.push_back(r);
    }
    next.resize(std::min(next.size(), REMEMBERED));
    search.rejected = std::move(next);
}

/// Search for discs away from the places `known`, and measure them.
std::vector<Measured> find_new_discs(const Photo& photo, const DiscModel& model, const Lattice& lattice, Search& search,
                                     const Points& known) {
    const double difference = 2.5 * search.sample_noise;
    if (!(std::abs(model.fit.contrast) <= 2.0 && std::abs(difference) < 1e6 && std::abs(photo.noise) < 1e6 &&
          std::abs(model.diameter) < 1e6))
        throw nb::value_error("model: must have a finite diameter and noise, and a contrast up to 2");
    const Limits limits{int(256.0 * (1.0 - 0.5 * model.fit.contrast)), int(difference), 0.5 * model.diameter,
                        lattice.reduction};
    const Points places = find(Plane(photo), lattice, limits, search, known);
    const std::vector<Measured> found = measure_places(photo, places, model, {0.0, search.discs.contrast});
    Points rejected;
    for (const Vector<2>& place : places)
        if (std::none_of(found.begin(), found.end(),
                         [&](const Measured& m) { return (m.centre - place).norm() < limits.radius; }))
            rejected.push_back(place);
    next_turn(search, rejected, lattice.reduction);
    return found;
}

/// Read the part of a `search.Lattice` for one turn.
Lattice read_lattice(nb::handle given, const Image& image) {
    const nb::tuple lattice = members(given, 3, "lattice");
    const nb::tuple samples = members(lattice[0], 3, "samples");
    const auto place = array<const int32_t, -1, 2>(samples[0], "place");
    const auto sides = array<const uint8_t, -1>(samples[1], "sides");
    const auto along = array<const int32_t, -1, 2, 2>(samples[2], "along");
    const auto offsets = array<const int32_t, SIDES, 2>(lattice[1], "offsets");
    if (sides.shape(0) != place.shape(0) || along.shape(0) != place.shape(0))
        throw nb::type_error("sides, along: must have the length of place");
    Lattice read{place.shape(0), place.data(), along.data(), sides.data(), {}, number<int>(lattice[2], "lattice")};
    if (read.reduction < 1 || read.reduction > 1000) throw nb::value_error("reduction: must be from 1 to 1000");
    for (size_t k = 0; k < SIDES; k++)
        read.step[k] = (ptrdiff_t(offsets(k, 1)) * image.shape(1) + offsets(k, 0)) * image.shape(2);
    return read;
}

/// Read a `search.SearchState`.
Search read_search(const nb::tuple& given) {
    const auto scalar = [&](int i) { return number<double>(given[i], "search"); };
    Search search{number<int64_t>(given[0], "search"), {scalar(2), scalar(4)}, scalar(5), {}};
    const auto rejected = matrix<Dynamic, 4>(given[3], "rejected");
    if (search.turn < 0 || search.turn >= int64_t(1) << 53) throw nb::value_error("turn: must be from 0 to 2^53");
    for (nb::ssize_t i = 0; i < rejected.rows(); i++)
        search.rejected.push_back({rejected.block<1, 2>(i, 0), rejected(i, 2), rejected(i, 3)});
    return search;
}

nb::tuple follow_discs(nb::handle image, nb::handle directions_, nb::handle model_, nb::handle lattice_,
                       nb::handle search_, nb::handle motion_, nb::handle known_, size_t least) {
    const nb::tuple given = members(search_, 6, "search");
    Search search = read_search(given);
    const double noise = number<double>(given[1], "search");
    const auto [model, photo] = read_model(model_, image, noise);
    const Lattice lattice = read_lattice(lattice_, photo.image);
    const Directions directions = matrix<Dynamic, 3>(directions_, "directions");
    const Motion motion = read_motion(motion_);
    const auto places = matrix<Dynamic, 2>(known_, "known");
    std::vector<Measured> found;
    {
        nb::gil_scoped_release release;
        found = measure(photo, directions, model, motion, search.discs);
        if (found.size() >= least) {
            Points known;
            for (const Measured& m : found) known.push_back(m.centre);
            for (nb::ssize_t i = 0; i < places.rows(); i++) known.push_back(places.row(i));
            const std::vector<Measured> more = find_new_discs(photo, model, lattice, search, known);
            found.insert(found.end(), more.begin(), more.end());
        }
    }
    const Rows<4> rejected(search.rejected.size());
    for (size_t i = 0; i < search.rejected.size(); i++) {
        const Rejection& r = search.rejected[i];
        rejected[i] << r.place, r.until, r.wait;
    }
    return to_numpy(found, nb::make_tuple(search.turn, noise, search.discs.size, rejected.array, search.discs.contrast,
                                          search.sample_noise));
}

}  // namespace

void bind_search(nb::module_& m) {
    m.def("follow_discs", &follow_discs, arg("image"), arg("directions"), arg("model"), arg("lattice"), arg("search"),
          arg("motion"), arg("known"), arg("least"));
}

}  // namespace spheremouse::ball
