#include "spheremouse/ball/texture/picture.h"

namespace spheremouse::ball {

WIDE void Look::at(const Picture& picture, const Matrix3f& towards, const float* x, const float* y, const float* z,
                   size_t count) {
    const int n = picture.n;
    const float t[9] = {towards(0, 0), towards(0, 1), towards(0, 2), towards(1, 0), towards(1, 1),
                        towards(1, 2), towards(2, 0), towards(2, 1), towards(2, 2)};
    size = std::min(MOST, count);
    int cell[MOST], axis[MOST];
    float down[MOST], right[MOST], by_row[MOST], by_column[MOST], sign[MOST];
    for (size_t i = 0; i < size; i++) {
        const Place p = place_on(t[0] * x[i] + t[1] * y[i] + t[2] * z[i], t[3] * x[i] + t[4] * y[i] + t[5] * z[i],
                                 t[6] * x[i] + t[7] * y[i] + t[8] * z[i], n);
        cell[i] = (p.face * n + p.row) * n + p.column;
        tile[i] = (p.face * (n / TILE) + p.row / TILE) * (n / TILE) + p.column / TILE;
        axis[i] = p.face / 2;
        down[i] = p.down, right[i] = p.right, by_row[i] = p.by_row, by_column[i] = p.by_column, sign[i] = p.sign;
    }
    float left[MOST], across[MOST], left_below[MOST], across_below[MOST];
    for (size_t i = 0; i < size; i++) {
        const float *v = picture.value + cell[i], *w = picture.weight + cell[i];
        left[i] = v[0], across[i] = v[1] - v[0], left_below[i] = v[n], across_below[i] = v[n + 1] - v[n];
        weight[i] = std::min(std::min(w[0], w[1]), std::min(w[n], w[n + 1]));
    }
    const float k = float(n) / (2.0f * HALF);
    for (size_t i = 0; i < size; i++) {
        const float fall = left_below[i] - left[i], slope = across[i] + down[i] * (across_below[i] - across[i]);
        value[i] = left[i] + down[i] * fall + right[i] * slope;
        const float row = k * (fall + right[i] * (across_below[i] - across[i])), column = k * slope;
        const float out = row * by_row[i] + column * by_column[i];  // the change towards the face's middle
        const float a = row * by_column[i] - column * by_row[i], b = sign[i] * (column + out * by_column[i]),
                    c = -sign[i] * (row + out * by_row[i]);  // about the axis of the face, and the next two
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

void Pixels::take(const Samples& samples, float least_odds) {
    make_room(samples.size + 1);
    size_t n = 0;
    for (size_t i = 0; i < samples.size; i++) {
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

Picture read_picture(nb::tuple picture) {
    members(picture, 2, "picture");
    const auto value = array<float, 6, -1, -1>(picture[0], "value");
    const auto weight = array<float, 6, -1, -1>(picture[1], "weight");
    const int n = int(value.shape(1));
    if (n < TILE || n % TILE || int(value.shape(2)) != n || int(weight.shape(1)) != n || int(weight.shape(2)) != n)
        throw nb::type_error("value, weight: must have the shape (6, n, n), n a multiple of 8");
    return {value.data(), weight.data(), n};
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
