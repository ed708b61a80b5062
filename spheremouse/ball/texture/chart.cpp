// Grey values of an image on a chart, and the contrast there.
#include <cstring>

#include "spheremouse/native/arrays.h"

namespace spheremouse::ball {
namespace {

constexpr uint32_t PARTS = 128;  // of a pixel, between which places lie
constexpr int MOST_REACH =
    2;  // px from the middle of a small neighbourhood: sums of 25 * 25 bytes twice over columns fit into 16 bits

/// The pixels of a chart that show the ball.
struct Inside {
    const uint8_t* mask;  // (rows, columns) 255 on the ball, 0 elsewhere
    size_t rows, columns;

    /// Return the columns of a row, from the first on the ball to after the last one.
    std::pair<size_t, size_t> span(size_t row) const {
        const uint8_t* from = mask + row * columns;
        const void* found = std::memchr(from, 255, columns);
        if (found == nullptr) return {0, 0};
        const size_t first = size_t(static_cast<const uint8_t*>(found) - from);
        size_t end = columns;
        while (from[end - 1] != 255) end--;
        return {first, end};
    }
};

/// Put each pixel and the one below into one number.
WIDE void join_two(const uint8_t* upper, const uint8_t* lower, size_t n, uint16_t* __restrict out) {
    for (size_t j = 0; j < n; j++) out[j] = uint16_t(upper[j] | lower[j] << 8);
}

/// Return whether any of n indices does not exist.
WIDE bool any_beyond(const int* at, size_t n, size_t size) {
    unsigned beyond = 0;
    const unsigned end = unsigned(size);  // a negative index is larger than any
    for (size_t i = 0; i < n; i++) beyond |= unsigned(at[i]) >= end;
    return beyond;
}

/// Interpolate between four pixels each; `part` has those of the way to the next column and to the next row.
WIDE void interpolate(const uint16_t* two, const int* at, const uint16_t* part, const uint8_t* mask, size_t n,
                      uint8_t* __restrict out) {
    constexpr size_t BLOCK = 64;
    uint32_t four[BLOCK];
    for (size_t first = 0; first < n; first += BLOCK) {
        const size_t size = std::min(BLOCK, n - first);
        for (size_t i = 0; i < size; i++) std::memcpy(&four[i], two + at[first + i], sizeof(uint32_t));
        for (size_t i = 0; i < size; i++) {
            const uint32_t p = four[i], right = part[first + i] % PARTS, down = part[first + i] / PARTS % PARTS;
            const uint32_t upper = (p & 255) * (PARTS - right) + (p >> 16 & 255) * right,
                           lower = (p >> 8 & 255) * (PARTS - right) + (p >> 24) * right;
            out[first + i] = uint8_t((upper * (PARTS - down) + lower * down + PARTS * PARTS / 2) / (PARTS * PARTS)) &
                             mask[first + i];
        }
    }
}

NewArray<uint8_t> resample_chart(nb::handle image_, nb::handle at_, nb::handle part_, nb::handle inside_) {
    const auto image = array<const uint8_t, -1, -1>(image_, "image");
    const auto at = array<const int32_t, -1, -1>(at_, "at");
    const auto part = array<const uint16_t, -1, -1>(part_, "part");
    const auto mask = array<const uint8_t, -1, -1>(inside_, "inside");
    const size_t height = image.shape(0), width = image.shape(1);
    const Inside inside{mask.data(), at.shape(0), at.shape(1)};
    if (part.shape(0) != inside.rows || part.shape(1) != inside.columns || mask.shape(0) != inside.rows ||
        mask.shape(1) != inside.columns)
        throw nb::type_error("part, inside: must have the shape of at");
    for (size_t i = 0; i < inside.rows; i++) {
        const auto [first, end] = inside.span(i);
        if (any_beyond(at.data() + i * inside.columns + first, end - first, image.size()))
            throw nb::index_error("at: no such pixel");
    }
    auto chart = zeros<uint8_t>({inside.rows, inside.columns});
    nb::gil_scoped_release release;
    thread_local std::vector<uint16_t> two;  // kept: the pages of new memory take long
    two.resize(image.size() + 1);
    for (size_t i = 0; i < height; i++)
        join_two(image.data() + i * width, image.data() + std::min(i + 1, height - 1) * width, width,
                 two.data() + i * width);
    for (size_t i = 0; i < inside.rows; i++) {
        const auto [first, end] = inside.span(i);
        const size_t k = i * inside.columns + first;
        interpolate(two.data(), at.data() + k, part.data() + k, mask.data() + k, end - first, chart.data() + k);
    }
    return chart;
}

/// A row of the chart whose contrast is computed.
struct ContrastRow {
    const uint8_t* light[4 * MOST_REACH + 1];  // rows of light, from 2 `reach` above to 2 `reach` below
    size_t first, end, n;                      // columns to compute, of n
    const float *far, *far_below;
    float down;         // part of the way from `far` to `far_below`
    uint16_t* columns;  // (n + 4 MOST_REACH,) memory for sums over columns, with zeros at both ends
    uint16_t* box;      // (n + 4 MOST_REACH,) memory for sums over a neighbourhood

    template <int REACH>
    [[gnu::always_inline]] void contrast(float* __restrict out) const;
};

/// Write the light less the mean of means over (2 REACH + 1)² pixels, over the light far around.
template <int REACH>
inline void ContrastRow::contrast(float* __restrict out) const {
    constexpr int WIDTH = 2 * REACH + 1, MARGIN = 2 * REACH;
    constexpr float share = 1.0f / float(WIDTH * WIDTH * WIDTH * WIDTH);
    uint16_t* __restrict down_sums = columns + 2 * MOST_REACH;
    uint16_t* __restrict sums = box + 2 * MOST_REACH;
    const size_t left = first > MARGIN ? first - MARGIN : 0, right = std::min(end + MARGIN, n);
    for (size_t j = left; j < right; j++) {
        unsigned sum = 0;
        for (int d = -MARGIN; d <= MARGIN; d++) sum += unsigned(WIDTH - std::abs(d)) * light[d + MARGIN][j];
        down_sums[j] = uint16_t(sum);
    }
    for (nb::ssize_t j = nb::ssize_t(first) - REACH; j < nb::ssize_t(end) + REACH; j++) {
        unsigned sum = 0;
        for (int d = -REACH; d <= REACH; d++) sum += down_sums[j + d];
        sums[j] = uint16_t(sum);
    }
    for (nb::ssize_t j = nb::ssize_t(first); j < nb::ssize_t(end); j++) {
        int sum = 0;
        for (int d = -REACH; d <= REACH; d++) sum += sums[j + d];
        out[j] = (float(light[MARGIN][j]) - float(sum) * share) / (far[j] + down * (far_below[j] - far[j]));
    }
}

WIDE void compute(const ContrastRow& row, int reach, float* out) {
    if (reach == 1)
        row.contrast<1>(out);
    else
        row.contrast<2>(out);
}

/// Return the place of pixel `i` on a chart of n pixels that are `ratio` times as large: the last one before, and the
/// part of the way to the next.
std::pair<size_t, float> place_on_coarse(size_t i, size_t ratio, size_t n) {
    const float x = std::clamp((float(i) + 0.5f) / float(ratio) - 0.5f, 0.0f, float(n - 1));
    return {size_t(x), x - float(size_t(x))};
}

/// Interpolate the values of a coarse row, by the pixels before and after each of n columns.
WIDE void widen(const float* row, const int* before, const int* next, const float* right, size_t n,
                float* __restrict out) {
    for (size_t j = 0; j < n; j++) out[j] = row[before[j]] + right[j] * (row[next[j]] - row[before[j]]);
}

/// What the contrast on a chart is computed from.
class Light {
    Array<const uint8_t, -1, -1> light_;
    Array<const float, -1, -1> far_;
    std::vector<float> wide_;  // `far_` with all columns
    std::vector<uint8_t> dark_;
    std::vector<uint16_t> sums_, box_;
    int reach_;

  public:
    Light(nb::handle light, nb::handle far, int reach);
    size_t rows() const { return light_.shape(0); }
    size_t columns() const { return light_.shape(1); }
    /// Interpolate what is far around each column.
    void prepare();
    /// Write the contrast of some columns of a row.
    void contrast(size_t row, size_t first, size_t end, float* out);
};

Light::Light(nb::handle light, nb::handle far, int reach)
    : light_(array<const uint8_t, -1, -1>(light, "light")),
      far_(array<const float, -1, -1>(far, "far")),
      reach_(reach) {
    const size_t few = far_.shape(0), n = far_.shape(1);
    if (n == 0 || few == 0 || columns() == 0 || rows() == 0 || columns() % n || rows() % few)
        throw nb::type_error("far: must have a pixel for each few of light");
    if (reach < 1 || reach > MOST_REACH) throw nb::index_error("reach: must be 1 or 2");
}

void Light::prepare() {
    const size_t few = far_.shape(0), n = far_.shape(1);
    wide_.resize(few * columns());
    dark_.resize(columns());
    for (auto* memory : {&sums_, &box_}) memory->resize(columns() + 4 * MOST_REACH);
    std::vector<int> before(columns()), next(columns());
    std::vector<float> right(columns());
    for (size_t j = 0; j < columns(); j++) {
        const auto [k, part] = place_on_coarse(j, columns() / n, n);
        before[j] = int(k), next[j] = int(std::min(k + 1, n - 1)), right[j] = part;
    }
    for (size_t i = 0; i < few; i++)
        widen(far_.data() + i * n, before.data(), next.data(), right.data(), columns(), &wide_[i * columns()]);
}

void Light::contrast(size_t row, size_t first, size_t end, float* out) {
    const size_t few = far_.shape(0);
    const auto [k, down] = place_on_coarse(row, rows() / few, few);
    ContrastRow work{{},
                     first,
                     end,
                     columns(),
                     wide_.data() + k * columns(),
                     wide_.data() + std::min(k + 1, few - 1) * columns(),
                     down,
                     sums_.data(),
                     box_.data()};
    for (int d = 0; d <= 4 * reach_; d++) {
        const size_t other = row + size_t(d) - 2 * size_t(reach_);  // above the first row it is larger than any
        work.light[d] = other < rows() ? light_.data() + other * columns() : dark_.data();
    }
    compute(work, reach_, out);
}

NewArray<float> contrast_on_chart(nb::handle light_, nb::handle inside_, nb::handle far, int reach) {
    Light light(light_, far, reach);
    const auto mask = array<const uint8_t, -1, -1>(inside_, "inside");
    const Inside inside{mask.data(), light.rows(), light.columns()};
    if (mask.shape(0) != inside.rows || mask.shape(1) != inside.columns)
        throw nb::type_error("inside: must have the shape of light");
    auto contrast = zeros<float>({inside.rows, inside.columns});
    nb::gil_scoped_release release;
    light.prepare();
    for (size_t i = 0; i < inside.rows; i++) {
        const auto [first, end] = inside.span(i);
        light.contrast(i, first, end, contrast.data() + i * inside.columns);
    }
    return contrast;
}

NewArray<float> contrast_of_samples(nb::handle light_, nb::handle at_, nb::handle far, int reach) {
    Light light(light_, far, reach);
    const auto at = array<const int32_t, -1>(at_, "at");
    const size_t n = light.columns();
    if (any_beyond(at.data(), at.size(), light.rows() * n)) throw nb::index_error("at: no such pixel");
    auto contrast = zeros<float>({at.size()});
    nb::gil_scoped_release release;
    light.prepare();
    std::vector<float> line(n);
    for (size_t i = 0; i < at.size();) {
        const size_t row = size_t(at.data()[i]) / n;
        const int start = int(row * n);
        size_t end = i, first = n, last = 0;
        for (; end < at.size() && at.data()[end] >= start && at.data()[end] < start + int(n); end++) {
            first = std::min(first, size_t(at.data()[end] - start));
            last = std::max(last, size_t(at.data()[end] - start));
        }
        light.contrast(row, first, last + 1, line.data());
        for (; i < end; i++) contrast.data()[i] = line[size_t(at.data()[i] - start)];
    }
    return contrast;
}

}  // namespace

void bind_chart(nb::module_& m) {
    m.attr("PARTS") = PARTS;
    m.def("resample_chart", &resample_chart, arg("image"), arg("at"), arg("part"), arg("inside"));
    m.def("contrast_on_chart", &contrast_on_chart, arg("light"), arg("inside"), arg("far"), arg("reach"));
    m.def("contrast_of_samples", &contrast_of_samples, arg("light"), arg("at"), arg("far"), arg("reach"));
}

}  // namespace spheremouse::ball
