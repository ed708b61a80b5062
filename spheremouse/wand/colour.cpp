// Selection of colours by bounds on hue, saturation and brightness, and the growth of glare over pale print.
#include <cstring>

#include "spheremouse/native/arrays.h"

namespace spheremouse::wand {
namespace {

using Image = Array<const uint8_t, -1, -1, 3>;  // BGR
using Bounds = Array<const float, -1, 6>;       // least and greatest hue (degrees), saturation (of 1), brightness

constexpr float MIN_TINT = 0.25f;  // of a colour's least saturation: below is noise and white
constexpr float MAX_HALO = 8.0f;   // px
constexpr int OVEREXPOSED = 250;

struct Pixel {
    int b, g, r, high, spread;

    explicit Pixel(const uint8_t* p)
        : b(p[0]), g(p[1]), r(p[2]), high(std::max({b, g, r})), spread(high - std::min({b, g, r})) {}

    /// Hue in degrees, 0 to 360; 0 without a colour.
    float hue() const {
        if (spread == 0) return 0.0f;
        const float s = float(spread);
        const float hue = high == r   ? 60.0f * float(g - b) / s
                          : high == g ? 60.0f * float(b - r) / s + 120.0f
                                      : 60.0f * float(r - g) / s + 240.0f;
        return hue < 0.0f ? hue + 360.0f : hue;
    }
};

/// Return true if a hue lies from low to top, through 0 if low is greater.
bool hue_between(float hue, float low, float top) {
    return low <= top ? low <= hue && hue <= top : hue >= low || hue <= top;
}

/// Return true if a pixel has the hue of a colour, but only part of the required saturation.
bool is_tinted(const Pixel& p, const Bounds& bounds) {
    for (size_t c = 0; p.spread > 0 && c < bounds.shape(0); c++) {
        const float *k = &bounds(c, 0), least = k[2] * float(p.high);
        if (MIN_TINT * least < float(p.spread) && float(p.spread) < least && hue_between(p.hue(), k[0], k[1]))
            return true;
    }
    return false;
}

/// Mark pixels, 1 for one that can have a colour, 2 for an overexposed one. A loop without branches.
WIDE void mark(const uint8_t* bgr, size_t pixels, int grey, int low, int high, uint8_t* flag) {
    for (size_t i = 0; i < pixels; i++) {
        const int b = bgr[3 * i], g = bgr[3 * i + 1], r = bgr[3 * i + 2];
        const int most = std::max(std::max(b, g), r), least = std::min(std::min(b, g), r);
        flag[i] = uint8_t(((most - least) * 256 >= grey * most) & (most >= low) & (most <= high)) |
                  uint8_t((least >= OVEREXPOSED) << 1);
    }
}

int64_t select(const Image& image, const Bounds& bounds, uint8_t* binary, int64_t* count, uint8_t* white) {
    const size_t pixels = image.shape(0) * image.shape(1);
    float least = 1.0f, darkest = 255.0f, brightest = 0.0f;
    for (size_t c = 0; c < bounds.shape(0); c++) {
        least = std::min(least, bounds(c, 2));
        darkest = std::min(darkest, bounds(c, 4));
        brightest = std::max(brightest, bounds(c, 5));
    }
    const int grey = int(std::max(least, 0.0f) * 256.0f), low = int(std::max(darkest, 0.0f)),
              high = int(std::min(brightest, 255.0f));
    int64_t some = 0;
    std::vector<uint8_t> flag(pixels);
    mark(image.data(), pixels, grey, low, high, flag.data());
    for (size_t i = 0; i < pixels; i++) {
        uint64_t eight = 1;
        if (i + 8 <= pixels) std::memcpy(&eight, &flag[i], 8);
        if (eight == 0) i += 7;
        if (eight == 0 || flag[i] == 0) continue;
        if (flag[i] & 2) white[i] = 255, some++;
        if (!(flag[i] & 1)) continue;
        const Pixel p(image.data() + 3 * i);
        const float hue = p.hue(), value = float(p.high), spread = float(p.spread);
        for (size_t c = 0; c < bounds.shape(0); c++) {
            const float* k = &bounds(c, 0);
            if (!hue_between(hue, k[0], k[1]) || spread < k[2] * value || spread > k[3] * value || value < k[4] ||
                value > k[5])
                continue;
            binary[c * pixels + i] = 255;
            count[c]++;
            some -= white[i] > 0;
            white[i] = 0;
        }
    }
    return some;
}

nb::tuple select_colours(nb::handle image_, nb::handle bounds_) {
    const auto image = array<const uint8_t, -1, -1, 3>(image_, "image");
    const auto bounds = array<const float, -1, 6>(bounds_, "bounds");
    auto binary = zeros<uint8_t>({bounds.shape(0), image.shape(0), image.shape(1)});
    auto count = zeros<int64_t>({bounds.shape(0)});
    auto white = zeros<uint8_t>({image.shape(0), image.shape(1)});
    int64_t some;
    {
        nb::gil_scoped_release release;
        some = select(image, bounds, binary.data(), count.data(), white.data());
    }
    return nb::make_tuple(binary, count, white, some);
}

/// Return the connected areas of a binary picture in the order of their first pixels: box, area and centre, (n, 7),
/// then all their pixels, row and column, (k, 2), and the index of each area's first one, (n + 1,).
nb::tuple connected_areas(nb::handle binary_, bool diagonal) {
    const auto binary = array<const uint8_t, -1, -1>(binary_, "binary");
    const int h = int(binary.shape(0)), w = int(binary.shape(1));
    std::vector<uint8_t> open(binary.data(), binary.data() + size_t(h) * size_t(w));
    std::vector<std::pair<int, int>> pixels;
    std::vector<int64_t> first{0};
    for (size_t at = 0; at < open.size(); at++) {
        const void* next = std::memchr(open.data() + at, 255, open.size() - at);
        if (next == nullptr) break;
        at = size_t(static_cast<const uint8_t*>(next) - open.data());
        open[at] = 0;
        pixels.emplace_back(int(at / size_t(w)), int(at % size_t(w)));
        for (size_t done = size_t(first.back()); done < pixels.size(); done++) {
            const auto [i, j] = pixels[done];
            for (int k = std::max(i - 1, 0); k < std::min(i + 2, h); k++) {
                for (int l = std::max(j - 1, 0); l < std::min(j + 2, w); l++) {
                    uint8_t& to = open[size_t(k) * size_t(w) + size_t(l)];
                    if (to != 255 || (!diagonal && k != i && l != j)) continue;
                    to = 0;
                    pixels.emplace_back(k, l);
                }
            }
        }
        first.push_back(int64_t(pixels.size()));
    }
    auto areas = zeros<double>({first.size() - 1, 7});
    auto places = zeros<int64_t>({pixels.size(), 2}), starts = zeros<int64_t>({first.size()});
    std::copy(first.begin(), first.end(), starts.data());
    for (size_t n = 0; n + 1 < first.size(); n++) {
        int left = w, top = h, right = 0, bottom = 0;
        double u = 0.0, v = 0.0;
        for (size_t p = size_t(first[n]); p < size_t(first[n + 1]); p++) {
            const auto [i, j] = pixels[p];
            places.data()[2 * p] = i, places.data()[2 * p + 1] = j;
            left = std::min(left, j), right = std::max(right, j), top = std::min(top, i), bottom = std::max(bottom, i);
            u += j, v += i;
        }
        const double size = double(first[n + 1] - first[n]);
        const double row[7] = {double(left), double(top), double(right - left + 1), double(bottom - top + 1), size,
                               u / size,     v / size};
        std::copy(row, row + 7, areas.data() + 7 * n);
    }
    return nb::make_tuple(areas, places, starts);
}

void grow_glare(nb::handle image_, nb::handle bounds_, nb::handle distance_, int top, int left, float reach,
                nb::handle pale_) {
    const auto image = array<const uint8_t, -1, -1, 3>(image_, "image");
    const auto bounds = array<const float, -1, 6>(bounds_, "bounds");
    const auto distance = array<const float, -1, -1>(distance_, "distance");
    auto pale = array<uint8_t, -1, -1>(pale_, "pale");
    const int h = int(distance.shape(0)), w = int(distance.shape(1));
    if (image.shape(0) != pale.shape(0) || image.shape(1) != pale.shape(1))
        throw nb::type_error("pale: must have the size of image");
    if (top < 0 || left < 0 || size_t(top) + size_t(h) > image.shape(0) || size_t(left) + size_t(w) > image.shape(1))
        throw nb::type_error("distance: must lie in image");
    std::vector<std::pair<int, int>> open;
    for (int i = 0; i < h; i++) {
        for (int j = 0; j < w; j++) {
            if (distance(i, j) > reach) continue;
            pale(top + i, left + j) = 255;
            open.emplace_back(i, j);
        }
    }
    while (!open.empty()) {
        const auto [i, j] = open.back();
        open.pop_back();
        for (int k = std::max(i - 1, 0); k < std::min(i + 2, h); k++) {
            for (int l = std::max(j - 1, 0); l < std::min(j + 2, w); l++) {
                uint8_t& to = pale(top + k, left + l);
                if (to != 0 || distance(k, l) > MAX_HALO || !is_tinted(Pixel(&image(top + k, left + l, 0)), bounds))
                    continue;
                to = 255;
                open.emplace_back(k, l);
            }
        }
    }
}

}  // namespace

void bind_colour(nb::module_& m) {
    m.def("select_colours", &select_colours, arg("image"), arg("bounds"));
    m.def("connected_areas", &connected_areas, arg("binary"), arg("diagonal"));
    m.def("grow_glare", &grow_glare, arg("image"), arg("bounds"), arg("distance"), arg("top"), arg("left"),
          arg("reach"), arg("pale"));
}

}  // namespace spheremouse::wand
