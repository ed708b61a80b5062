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
    float down, right, by_row, by_column, sign;  // coordinates on the face, and the sign of its axis
};

/// Return the last cell of a row of n at or before `x` that has a next one. It exists for any `x`, nan as well.
inline int cell_before(float x, int n) {
    const float last = float(n - 2);
    return int(x > 0.0f ? (x < last ? x : last) : 0.0f);
}

/// Return the place of a direction. It has no branch, so that a loop of it has vectors.
inline Place place_on(float x, float y, float z, int n) {
    const float size_x = std::abs(x), size_y = std::abs(y), size_z = std::abs(z), k = float(n) / (2.0f * HALF);
    const bool is_x = (size_x >= size_y) & (size_x >= size_z), is_y = !is_x & (size_y >= size_z);
    const float depth = is_x ? x : is_y ? y : z, inverse = 1.0f / std::abs(depth);
    const float a = (is_x ? y : is_y ? z : x) * inverse, b = (is_x ? z : is_y ? x : y) * inverse;
    const float row = (a + HALF) * k - 0.5f, column = (b + HALF) * k - 0.5f;
    const int i = cell_before(row, n), j = cell_before(column, n), below = depth < 0.0f ? 1 : 0;
    return {(is_x ? 0 : is_y ? 2 : 4) + below, i, j, row - float(i), column - float(j), a, b, below ? -1.0f : 1.0f};
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

/// The samples of a picture of the camera: every few pixels of the chart that show the ball.
struct Samples {
    const float* contrast;       // (n,)
    const float *x, *y, *z;      // (n,) direction, obj
    const float *odds, *offset;  // (n,) log odds to turn with the ball; contrast that stands still: of light, its
                                 // shadows and reflections
    size_t size;
};

/// Some samples in columns: number, contrast without what stands still, and direction (obj).
class Pixels {
    size_t size_ = 0;  // the columns may be longer: the pages of new memory take long

    void make_room(size_t n);

  public:
    std::vector<int> sample;
    std::vector<float> contrast, x, y, z;

    size_t size() const { return size_; }
    /// Take the samples with a direction, whose log odds are at least so large.
    void take(const Samples& samples, float least_odds);
    /// Take some of other pixels.
    void take(const Pixels& other, const std::vector<size_t>& which);
};

/// What a picture shows in the directions of some pixels.
struct Look {
    static constexpr size_t MOST = 64;
    size_t size;
    float value[MOST], weight[MOST];           // weight: the least of the four cells
    float by_x[MOST], by_y[MOST], by_z[MOST];  // change of the value by a rotation of the ball, in its axes
    int tile[MOST];

    /// Look at up to `MOST` of the `count` directions (x, y, z), obj, at an attitude `towards`, R_ball_obj.
    void at(const Picture& picture, const Matrix3f& towards, const float* x, const float* y, const float* z,
            size_t count);
};

Picture read_picture(nb::tuple picture);
Samples read_samples(nb::tuple samples);

}  // namespace spheremouse::ball
