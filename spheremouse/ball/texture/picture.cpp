#include "spheremouse/ball/texture/picture.h"

namespace spheremouse::ball {

WIDE void Look::at(const Picture& picture, const Matrix3f& towards, const Pixels& pixels, size_t first) {
    const int n = picture.n;
    const float *x = pixels.x.data() + first, *y = pixels.y.data() + first, *z = pixels.z.data() + first;
    const float t[9] = {towards(0, 0), towards(0, 1), towards(0, 2), towards(1, 0), towards(1, 1),
                        towards(1, 2), towards(2, 0), towards(2, 1), towards(2, 2)};
    size = std::min(MOST, pixels.size() - first);
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

Pixels pixels_on_ball(const Samples& samples, float least_odds) {
    Pixels found;
    found.reserve(size_t(samples.size()));
    const float* d = samples.direction;
    for (int row = 0, i = 0; row < samples.rows; row++)
        for (int column = 0; column < samples.columns; column++, i++, d += 3)
            if (samples.odds[i] >= least_odds && d[0] < 2.0f) found.add(i, samples.at(row, column), d[0], d[1], d[2]);
    return found;
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
    members(samples, 5, "samples");
    const auto contrast = array<const float, -1, -1>(samples[0], "contrast");
    const auto direction = array<const float, -1, -1, 3>(samples[1], "direction");
    const auto odds = array<const float, -1, -1>(samples[2], "odds");
    const auto offset = array<const float, -1, -1>(samples[3], "offset");
    const int64_t step = number<int>(samples[4], "samples");
    const int rows = int(direction.shape(0)), columns = int(direction.shape(1));
    for (const auto& each : {odds, offset})
        if (int(each.shape(0)) != rows || int(each.shape(1)) != columns)
            throw nb::type_error("odds, offset: must have the shape of direction");
    if (step < 1 || (rows - 1) * step >= int64_t(contrast.shape(0)) ||
        (columns - 1) * step >= int64_t(contrast.shape(1)))
        throw nb::type_error("contrast: must have a pixel for each sample");
    return {contrast.data(), direction.data(), odds.data(), offset.data(), int(contrast.shape(1)), rows,
            columns,         int(step)};
}

}  // namespace spheremouse::ball
