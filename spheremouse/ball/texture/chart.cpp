// Grey values of an image on a chart, and the contrast there.
#include "spheremouse/native/arrays.h"

namespace spheremouse::ball {
namespace {

constexpr uint32_t PARTS = 128;  // of a pixel, between which places lie

/// Put each pixel and the next ones to the right and below into one number. The last ones are their own neighbours.
WIDE void join_four(const uint8_t* upper, const uint8_t* lower, size_t n, uint32_t* __restrict out) {
    for (size_t j = 0; j + 1 < n; j++)
        out[j] =
            uint32_t(upper[j]) | uint32_t(upper[j + 1]) << 8 | uint32_t(lower[j]) << 16 | uint32_t(lower[j + 1]) << 24;
    out[n - 1] = upper[n - 1] * 0x101u | lower[n - 1] * 0x1010000u;
}

/// Return whether any of n indices does not exist.
WIDE bool any_beyond(const int* at, size_t n, size_t size) {
    unsigned beyond = 0;
    const unsigned end = unsigned(size);  // a negative index is larger than any
    for (size_t i = 0; i < n; i++) beyond |= unsigned(at[i]) >= end;
    return beyond;
}

/// Interpolate between four pixels each; `part` has those of the way to the next column and to the next row.
WIDE void interpolate(const uint32_t* four, const int* at, const uint16_t* part, size_t n, uint8_t* __restrict out) {
    for (size_t i = 0; i < n; i++) {
        const uint32_t p = four[at[i]], right = part[i] % PARTS, down = part[i] / PARTS % PARTS;
        const uint32_t upper = (p & 255) * (PARTS - right) + (p >> 8 & 255) * right,
                       lower = (p >> 16 & 255) * (PARTS - right) + (p >> 24) * right;
        out[i] = uint8_t((upper * (PARTS - down) + lower * down + PARTS * PARTS / 2) / (PARTS * PARTS));
    }
}

NewArray<uint8_t> resample_chart(nb::handle image_, nb::handle at_, nb::handle part_) {
    const auto image = array<const uint8_t, -1, -1>(image_, "image");
    const auto at = array<const int32_t, -1, -1>(at_, "at");
    const auto part = array<const uint16_t, -1, -1>(part_, "part");
    const size_t height = image.shape(0), width = image.shape(1);
    if (part.shape(0) != at.shape(0) || part.shape(1) != at.shape(1))
        throw nb::type_error("part: must have the shape of at");
    if (any_beyond(at.data(), at.size(), image.size())) throw nb::index_error("at: no such pixel");
    auto chart = zeros<uint8_t>({at.shape(0), at.shape(1)});
    nb::gil_scoped_release release;
    thread_local std::vector<uint32_t> four;  // kept: the pages of new memory take long
    four.resize(image.size());
    for (size_t i = 0; i < height && width > 0; i++)
        join_four(image.data() + i * width, image.data() + std::min(i + 1, height - 1) * width, width,
                  four.data() + i * width);
    interpolate(four.data(), at.data(), part.data(), at.size(), chart.data());
    return chart;
}

WIDE void contrast_row(const uint8_t* light, const float* sum, const float* share, const float* far,
                       const float* far_below, float down, size_t n, float* __restrict out) {
    for (size_t j = 0; j < n; j++)
        out[j] = (float(light[j]) - sum[j] * share[j]) / (far[j] + down * (far_below[j] - far[j]));
}

/// Return the place of pixel `i` on a chart of n pixels that are `ratio` times as large: the last one before, and the
/// part of the way to the next.
std::pair<size_t, float> place_on_coarse(size_t i, size_t ratio, size_t n) {
    const float x = std::clamp((float(i) + 0.5f) / float(ratio) - 0.5f, 0.0f, float(n - 1));
    return {size_t(x), x - float(size_t(x))};
}

NewArray<float> contrast_on_chart(nb::handle light_, nb::handle sum_, nb::handle share_, nb::handle far_) {
    const auto light = array<const uint8_t, -1, -1>(light_, "light");
    const auto sum = array<const float, -1, -1>(sum_, "sum"), share = array<const float, -1, -1>(share_, "share"),
               far = array<const float, -1, -1>(far_, "far");
    const size_t rows = light.shape(0), columns = light.shape(1), few = far.shape(0), n = far.shape(1);
    for (const auto& each : {sum, share})
        if (each.shape(0) != rows || each.shape(1) != columns)
            throw nb::type_error("sum, share: must have the shape of light");
    if (n == 0 || few == 0 || columns % n || rows % few)
        throw nb::type_error("far: must have a pixel for each few of light");
    auto contrast = zeros<float>({rows, columns});
    nb::gil_scoped_release release;
    thread_local std::vector<float> wide;  // `far` with all columns
    wide.resize(few * columns);
    for (size_t j = 0; j < columns; j++) {
        const auto [k, right] = place_on_coarse(j, columns / n, n);
        for (size_t i = 0; i < few; i++) {
            const float* at = far.data() + i * n;
            wide[i * columns + j] = at[k] + right * (at[std::min(k + 1, n - 1)] - at[k]);
        }
    }
    for (size_t i = 0; i < rows; i++) {
        const auto [k, down] = place_on_coarse(i, rows / few, few);
        contrast_row(light.data() + i * columns, sum.data() + i * columns, share.data() + i * columns,
                     wide.data() + k * columns, wide.data() + std::min(k + 1, few - 1) * columns, down, columns,
                     contrast.data() + i * columns);
    }
    return contrast;
}

}  // namespace

void bind_chart(nb::module_& m) {
    m.attr("PARTS") = PARTS;
    m.def("resample_chart", &resample_chart, arg("image"), arg("at"), arg("part"));
    m.def("contrast_on_chart", &contrast_on_chart, arg("light"), arg("sum"), arg("share"), arg("far"));
}

}  // namespace spheremouse::ball
