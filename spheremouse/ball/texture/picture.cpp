#include "spheremouse/ball/texture/picture.h"

namespace spheremouse::ball {

WIDE void Look::at(const Picture& picture, const Matrix3f& towards, const float* x, const float* y, const float* z,
                   size_t count) {
    const int n = picture.n;
    float *const *values = picture.value.data(), *const *weights = picture.weight.data();
    const float t[9] = {towards(0, 0), towards(0, 1), towards(0, 2), towards(1, 0), towards(1, 1),
                        towards(1, 2), towards(2, 0), towards(2, 1), towards(2, 2)};
    size = std::min(MOST, count);
    int band[MOST], cell[MOST], band_below[MOST], cell_below[MOST], axis[MOST];
    float down[MOST], right[MOST], by_row[MOST], by_column[MOST], sign[MOST];
    for (size_t i = 0; i < size; i++) {
        const Place p = place_on(t[0] * x[i] + t[1] * y[i] + t[2] * z[i], t[3] * x[i] + t[4] * y[i] + t[5] * z[i],
                                 t[6] * x[i] + t[7] * y[i] + t[8] * z[i], n);
        const unsigned row = unsigned(p.row), below = row + 1;  // shifts divide
        band[i] = p.face * picture.bands + int(row / BAND), cell[i] = int(row % BAND) * n + p.column;
        band_below[i] = p.face * picture.bands + int(below / BAND), cell_below[i] = int(below % BAND) * n + p.column;
        tile[i] = (p.face * (n / TILE) + p.row / TILE) * (n / TILE) + p.column / TILE;
        axis[i] = p.face / 2;
        down[i] = p.down, right[i] = p.right, by_row[i] = p.by_row, by_column[i] = p.by_column, sign[i] = p.sign;
    }
    float left[MOST], across[MOST], left_below[MOST], across_below[MOST];
    for (size_t i = 0; i < size; i++) {
        const float *v = values[band[i]] + cell[i], *w = weights[band[i]] + cell[i],
                    *v_below = values[band_below[i]] + cell_below[i], *w_below = weights[band_below[i]] + cell_below[i];
        left[i] = v[0], across[i] = v[1] - v[0], left_below[i] = v_below[0], across_below[i] = v_below[1] - v_below[0];
        weight[i] = std::min(std::min(w[0], w[1]), std::min(w_below[0], w_below[1]));
    }
    const float k = float(n) / (2.0f * HALF);
    for (size_t i = 0; i < size; i++) {
        const float fall = left_below[i] - left[i], slope = across[i] + down[i] * (across_below[i] - across[i]);
        value[i] = left[i] + down[i] * fall + right[i] * slope;
        const float by_i = k * (fall + right[i] * (across_below[i] - across[i])), by_j = k * slope;
        const float out = by_i * by_row[i] + by_j * by_column[i];  // the change towards the face's middle
        const float a = by_i * by_column[i] - by_j * by_row[i], b = sign[i] * (by_j + out * by_column[i]),
                    c = -sign[i] * (by_i + out * by_row[i]);  // about the axis of the face, and the next two
        by_x[i] = axis[i] == 0 ? a : axis[i] == 1 ? c : b;
        by_y[i] = axis[i] == 0 ? b : axis[i] == 1 ? a : c;
        by_z[i] = axis[i] == 0 ? c : axis[i] == 1 ? b : a;
    }
}

void Pixels::make_room(size_t n) {
    if (sample.size() >= n) return;
    sample.resize(n);
    for (auto* column : {&contrast, &x, &y, &z}) column->resize(n);
}

void Pixels::take(const Samples& samples, float least_odds, size_t every) {
    make_room(samples.size / every + 2);
    size_t n = 0;
    for (size_t i = 0; i < samples.size; i += every) {
        sample[n] = int(i);
        contrast[n] = samples.contrast[i] - samples.offset[i];
        x[n] = samples.x[i], y[n] = samples.y[i], z[n] = samples.z[i];
        n += size_t((samples.odds[i] >= least_odds) & (samples.x[i] < 2.0f));  // a branch would be taken by chance
    }
    size_ = n;
}

void Pixels::take(const Pixels& other, const std::vector<size_t>& which) {
    make_room(which.size());
    size_ = which.size();
    for (size_t i = 0; i < size_; i++) {
        const size_t k = which[i];
        sample[i] = other.sample[k], contrast[i] = other.contrast[k];
        x[i] = other.x[k], y[i] = other.y[k], z[i] = other.z[k];
    }
}

Picture read_picture(nb::tuple bands) {
    Picture picture{};
    const size_t count = nb::len(bands);
    for (size_t k = 0; k < count; k++) {
        const auto band = array<float, 2, -1, -1>(bands[k], "bands");
        if (k == 0) picture.n = int(band.shape(2)), picture.bands = (picture.n + BAND - 1) / BAND;
        const int first = picture.bands > 0 ? int(k) % picture.bands * BAND : 0;
        const int rows = std::min(BAND, picture.n - first);
        if (picture.n < TILE || picture.n % TILE || int(band.shape(2)) != picture.n || int(band.shape(1)) != rows)
            throw nb::type_error(
                "bands: must have the shape (2, 32, n), n a multiple of 8, with fewer rows at the end");
        picture.value.push_back(band.data());
        picture.weight.push_back(band.data() + rows * picture.n);
    }
    if (count == 0 || count != 6 * size_t(picture.bands)) throw nb::type_error("bands: must be those of six faces");
    return picture;
}

Samples read_samples(nb::tuple samples) {
    members(samples, 4, "samples");
    const auto contrast = array<const float, -1>(samples[0], "contrast");
    const auto direction = array<const float, 3, -1>(samples[1], "direction");
    const auto odds = array<const float, -1>(samples[2], "odds"), offset = array<const float, -1>(samples[3], "offset");
    const size_t n = contrast.size();
    for (const auto& [size, name] :
         {std::pair(direction.shape(1), "direction"), {odds.size(), "odds"}, {offset.size(), "offset"}})
        if (size != n) throw nb::type_error((std::string(name) + ": must have the length of contrast").c_str());
    const float* x = direction.data();
    return {contrast.data(), x, x + n, x + 2 * n, odds.data(), offset.data(), n};
}

}  // namespace spheremouse::ball
