// Arguments of the detector, and the noise of a picture.
#include "spheremouse/ball/detect/disc_model.h"

namespace spheremouse::ball {
namespace {

/// Return the standard deviation of a projected pixel, from second differences along sixteen rows.
///
/// Their median: half of the pixels may be edges.
double noise_of(nb::handle image_, nb::handle weights_, int top, int bottom, int left, int right) {
    const auto image = array<const uint8_t, -1, -1, -1>(image_, "image");
    const auto weights = array<const float, -1>(weights_, "weights");
    if (weights.shape(0) != image.shape(2)) throw nb::type_error("weights: must have one for each channel of image");
    if (top < 0 || left < 0 || bottom < top || right < left || bottom > int(image.shape(0)) ||
        right > int(image.shape(1)))
        throw nb::value_error("window: must lie in image");
    constexpr double ROUNDING = 0.29;  // standard deviation of a whole number
    int count[1024] = {}, total = 0;
    const int step = std::max((bottom - top) / 16, 1);
    for (int i = top + step / 2; i < bottom; i += step)
        for (int j = left + 1; j < right - 1; j++) {
            float d = 0.0f;
            for (size_t c = 0; c < weights.shape(0); c++) {
                const uint8_t* p = &image(size_t(i), size_t(j), c);
                d += weights(c) * float(2 * p[0] - p[-int(weights.shape(0))] - p[weights.shape(0)]);
            }
            count[int(std::min(1023.0f, std::fabs(d) + 0.5f))]++;
            total++;
        }
    int below = 0;
    for (int d = 0; d < 1024; below += count[d++])
        if (2 * (below + count[d]) >= total)  // of whole numbers the median lies within the step: interpolated
            return std::max((d - 0.5 + (0.5 * total - below) / std::max(count[d], 1)) * 1.4826 / std::sqrt(6.0),
                            ROUNDING);
    return ROUNDING;
}

}  // namespace

Photo read_photo(nb::handle image_, nb::handle mask_, nb::handle projection, double noise) {
    const auto image = array<const uint8_t, -1, -1, -1>(image_, "image");
    const auto mask = array<const uint8_t, -1, -1>(mask_, "mask");
    if (image.shape(0) != mask.shape(0) || image.shape(1) != mask.shape(1) || image.size() == 0)
        throw nb::type_error("mask: must have the size of image");
    if (image.shape(2) != 1 && image.shape(2) != 3) throw nb::type_error("image: must have one channel or three");
    Photo photo{image, mask, {}, noise};
    const nb::tuple weights = members(members(projection, 1, "projection")[0], 3, "weights");
    float sum = 0.0f;
    for (size_t k = 0; k < 3; k++) {
        sum += photo.weights[k] = number<float>(weights[k], "weights");
        if (!(std::abs(photo.weights[k]) <= 1.0f)) throw nb::value_error("weights: must be from -1 to 1");
    }
    if (image.shape(2) == 1) photo.weights[0] = sum >= 0.0f ? 1.0f : -1.0f;
    return photo;
}

FitSettings read_fit_settings(nb::handle given) {
    const nb::tuple settings = members(given, 7, "settings");
    const auto scalar = [&](int i) { return number<double>(settings[i], "settings"); };
    return {scalar(1), scalar(2), scalar(3), scalar(4), scalar(5), scalar(6)};
}

void bind_photo(nb::module_& m) {
    m.def("noise_of", &noise_of, arg("image"), arg("weights"), arg("top"), arg("bottom"), arg("left"), arg("right"));
}

}  // namespace spheremouse::ball
