// Peaks of the slopes along lines across a predicted outline: the candidates of `outline.py` for its edges.
#include <nanobind/stl/tuple.h>

#include "spheremouse/native/matrices.h"

namespace spheremouse::ball {
namespace {

constexpr int SLOPE = 8, FINE = 4;  // samples on each side of an edge that find it, and that place it
constexpr int MIXED = 6;  // samples of a quarter of a pixel across its diagonal: a black pixel mixes into so many

using Image = Array<const uint8_t, -1, -1, -1>;

/// Write the colours at (x, y) px to `colours`, between pixels linearly; beyond the image the last pixels repeat.
/// Return whether the place is black, as where a recording has no pixels.
bool sample(const Image& image, double x, double y, float* colours) {
    const auto clamped = [](double place, size_t size) { return place > 0.0 ? std::min(place, size - 1.0) : 0.0; };
    const size_t h = image.shape(0), w = image.shape(1), channels = image.shape(2);
    x = clamped(x, w), y = clamped(y, h);
    const size_t left = size_t(x), top = size_t(y);
    const size_t right = left + 1 < w ? channels : 0, below = top + 1 < h ? w * channels : 0;  // steps to those pixels
    const float a = float(x - double(left)), b = float(y - double(top));
    const uint8_t* pixel = image.data() + (top * w + left) * channels;
    bool black = true;
    for (size_t k = 0; k < channels; k++, pixel++) {
        const float upper = pixel[0] + a * (float(pixel[right]) - pixel[0]);
        const float lower = pixel[below] + a * (float(pixel[below + right]) - pixel[below]);
        colours[k] = upper + b * (lower - upper);
        black &= colours[k] < 0.5f;
    }
    return black;
}

/// Samples along one line.
struct Line {
    size_t channels;
    std::vector<float> sums;  // of the colours before each sample
    std::vector<int> black;   // number of black samples before each

    Line(size_t samples, size_t channels)
        : channels(channels), sums((samples + 1) * channels), black(samples + 1) {}

    /// Replace the samples by those of a line that begins at a place, px, and has a step, px.
    void read(const Image& image, const Vector<2>& from, const Vector<2>& step) {
        float colours[4];
        for (size_t j = 0; j + 1 < black.size(); j++) {
            black[j + 1] = black[j] + sample(image, from.x() + double(j) * step.x(), from.y() + double(j) * step.y(),
                                             colours);
            for (size_t k = 0; k < channels; k++) sums[(j + 1) * channels + k] = sums[j * channels + k] + colours[k];
        }
    }

    /// Return the difference of the means of so many samples before j and from j on, of the colour that differs most.
    ///
    /// It is -1 where a black sample mixes into the means.
    float slope(size_t j, int means = SLOPE) const {
        const size_t end = black.size() - 1, margin = means + MIXED;
        if (black[std::min(j + margin, end)] > black[j > margin ? j - margin : 0]) return -1.0f;
        const float* here = &sums[j * channels];
        float most = 0.0f;
        for (size_t k = 0; k < channels; k++) {
            const float before = here[k] - here[ptrdiff_t(k) - ptrdiff_t(means * channels)];
            most = std::max(most, std::abs(here[k + means * channels] - here[k] - before));
        }
        return most / float(means);
    }
};

/// Return the place of the greatest of three values between its neighbours, by a parabola: -1/2 to 1/2.
double vertex(float before, float greatest, float after) {
    const float bend = (greatest - before) + (greatest - after);
    return bend > 0.0f ? 0.5 * double(after - before) / double(bend) : 0.0;
}

/// An edge on a line.
struct Edge {
    int sample = 0;  // at which the means differ most
    double place = 0.0;
    float slope = 0.0f;  // 0: there is no edge
};

/// Return the steepest edge between the samples `first` and `last` by so many means, and write the slopes there.
Edge steepest(const Line& line, int first, int last, int means, std::vector<float>& slope) {
    slope.clear();
    for (int j = first; j <= last; j++) slope.push_back(line.slope(size_t(j), means));
    Edge edge;
    for (size_t j = 1; j + 1 < slope.size(); j++) {
        const float before = slope[j - 1], here = slope[j], after = slope[j + 1];
        if (!(std::min(before, after) >= 0.0f && here >= std::max(before, after) && here > edge.slope)) continue;
        const int sample = first + int(j);
        edge = {sample, sample + vertex(before, here, after), here};
    }
    return edge;
}

std::tuple<NewArray<double>, NewArray<double>, double> outline_slopes(nb::handle image_, nb::handle starts,
                                                                       nb::handle steps, size_t samples) {
    const Image image = array<const uint8_t, -1, -1, -1>(image_, "image");
    const auto from = matrix<Dynamic, 2>(starts, "starts");
    const auto step = matrix<Dynamic, 2>(steps, "steps");
    if (step.rows() != from.rows()) throw nb::type_error("steps: must be an array with the length of starts");
    if (image.size() == 0 || image.shape(2) > 4) throw nb::type_error("image: must be an array with 1 to 4 channels");
    if (samples < 2 * SLOPE || samples > 100000) throw nb::type_error("samples: must be a number from 16 to 100000");
    const size_t n = size_t(from.rows());
    const int end = int(samples);
    Vector<Dynamic> strongest = Vector<Dynamic>::Zero(from.rows());
    Vector<Dynamic> where = Vector<Dynamic>::Zero(from.rows());
    std::vector<float> all;
    {
        const nb::gil_scoped_release unlocked;
        all.reserve(n * (samples - 2 * SLOPE + 1));
        Line line(samples, image.shape(2));
        std::vector<float> slope;
        for (size_t i = 0; i < n; i++) {
            line.read(image, from.row(i), step.row(i));
            const Edge found = steepest(line, SLOPE, end - SLOPE, SLOPE, slope);
            std::copy_if(slope.begin(), slope.end(), std::back_inserter(all), [](float s) { return s >= 0.0f; });
            if (found.slope == 0.0f) continue;
            // Another edge nearby mixes into long means and pulls this one. Short ones place it (Bergholm 1987).
            const int first = std::max(found.sample - SLOPE - 1, FINE);
            const int last = std::min(found.sample + SLOPE + 1, end - FINE);
            const Edge placed = steepest(line, first, last, FINE, slope);
            strongest(i) = found.slope;
            where(i) = placed.slope > 0.0f ? placed.place : found.sample;
        }
        const auto middle = all.begin() + ptrdiff_t(all.size() / 2);
        std::nth_element(all.begin(), middle, all.end());
    }
    return {to_numpy(strongest), to_numpy(where), all.empty() ? 0.0 : double(all[all.size() / 2])};
}

}  // namespace

void bind_outline(nb::module_& m) {
    m.attr("SLOPE") = SLOPE;
    m.def("outline_slopes", &outline_slopes, arg("image"), arg("starts"), arg("steps"), arg("samples"));
}

}  // namespace spheremouse::ball
