// The picture of a ball: the contrast of its surface, in cells on the six faces of a cube about it (gnomonic
// projection).
#pragma once

#include "spheremouse/native/matrices.h"

namespace spheremouse::ball {

constexpr float HALF = 1.1f;  // half the width of a face of the cube of half width 1: faces overlap, so each place on a
                              // face has four cells around it
constexpr int TILE = 8;       // cells along the edge of a tile
constexpr float LEAST_WEIGHT = 0.08f;  // of a cell: one oblique view
constexpr float STATIC_ODDS = -3.0f;   // log odds below which a sample does not turn with the ball

using Vector3f = Eigen::Vector3f;
using Matrix3f = Eigen::Matrix3f;

/// Six faces of (n, n) cells.
struct Picture {
    float *value, *weight;  // contrast; views that it is the mean of
    int n;

    int tiles() const { return n / TILE; }
};

/// A place on the picture: the cell above and left of it, and the shares of the next row and column.
struct Place {
    int face, row, column;
    float down, right;
    float by_row, by_column, inverse, sign;  // coordinates on the face, and one over the depth

    int tile(int n) const { return (face * (n / TILE) + row / TILE) * (n / TILE) + column / TILE; }
};

/// Return the last cell of a row of n at or before `x` that has a next one. It exists for any `x`, nan as well.
inline int cell_before(float x, int n) { return x > 0.0f ? int(std::min(x, float(n - 2))) : 0; }

inline Place place_on(const Vector3f& x, int n) {
    const Vector3f size = x.cwiseAbs();
    const int axis = size[0] >= size[1] ? (size[0] >= size[2] ? 0 : 2) : (size[1] >= size[2] ? 1 : 2);
    const int next = axis == 2 ? 0 : axis + 1, last = axis == 0 ? 2 : axis - 1;
    const float sign = x[axis] < 0.0f ? -1.0f : 1.0f, inverse = 1.0f / size[axis], k = float(n) / (2.0f * HALF);
    const float a = x[next] * inverse, b = x[last] * inverse;
    const float row = (a + HALF) * k - 0.5f, column = (b + HALF) * k - 0.5f;
    const int i = cell_before(row, n), j = cell_before(column, n);
    return {2 * axis + (sign < 0.0f), i, j, row - float(i), column - float(j), a, b, inverse, sign};
}

/// Return the direction of a cell of a face; it has no unit length.
inline Vector3f direction_of(int face, float row, float column, int n) {
    const float k = 2.0f * HALF / float(n);
    const int axis = face / 2;
    Vector3f x;
    x[axis] = face % 2 ? -1.0f : 1.0f;
    x[(axis + 1) % 3] = (row + 0.5f) * k - HALF;
    x[(axis + 2) % 3] = (column + 0.5f) * k - HALF;
    return x;
}

/// What the picture shows at a place: value, its gradient by the direction (ball), and the least weight of the cells.
struct Look {
    float value, weight;
    Vector3f gradient;
};

inline Look look(const Picture& picture, const Place& p) {
    const size_t at = (size_t(p.face) * picture.n + p.row) * picture.n + p.column, below = at + picture.n;
    const float *v = picture.value, *w = picture.weight;
    const float across = v[at + 1] - v[at], across_below = v[below + 1] - v[below];
    const float left = v[at] + p.down * (v[below] - v[at]), slope = across + p.down * (across_below - across);
    const float k = float(picture.n) / (2.0f * HALF);
    const float by_row = k * (v[below] - v[at] + p.right * (across_below - across)), by_column = k * slope;
    Look r{left + p.right * slope, std::min(std::min(w[at], w[at + 1]), std::min(w[below], w[below + 1])), {}};
    const int axis = p.face / 2;
    r.gradient[axis] = -(by_row * p.by_row + by_column * p.by_column) * p.inverse * p.sign;
    r.gradient[(axis + 1) % 3] = by_row * p.inverse;
    r.gradient[(axis + 2) % 3] = by_column * p.inverse;
    return r;
}

/// The samples of a picture of the camera, every few pixels: each with its direction on the ball.
struct Samples {
    const float* contrast;   // (h, w) of a window
    const float* direction;  // (rows, columns, 3) obj; nan: not on the ball
    const float* odds;       // (rows, columns) log odds that it turns with the ball
    const float* offset;     // (rows, columns) contrast that stands still: of light, its shadows and reflections
    int width, rows, columns, step;

    int size() const { return rows * columns; }
    float at(int row, int column) const {
        return contrast[size_t(row * step) * width + size_t(column * step)] - offset[row * columns + column];
    }
    Vector3f towards(int i) const { return Eigen::Map<const Vector3f>(direction + 3 * size_t(i)); }
};

Picture read_picture(nb::tuple picture);
Samples read_samples(nb::tuple samples);

}  // namespace spheremouse::ball
