// Matching of points: one-to-one assignment, mutual nearest neighbours, non-maximum suppression.
#pragma once

#include "spheremouse/native/matrices.h"

namespace spheremouse {

/// Return for each row of `worth`, (n, m), its column in the one-to-one pairs of greatest total worth, or -1.
///
/// An unpaired row is worth 0. If the best columns of all rows differ, they are the solution.
std::vector<int> match(const Eigen::Ref<const Matrix<Dynamic>>& worth);

/// Return for each row of a distance matrix, (n, m), the column if each is the other's nearest, else -1.
///
/// An infinite distance is no pair.
std::vector<int> mutual_nearest(const Matrix<Dynamic>& distance);

/// Return the indices of points, (n, d), that no earlier kept point has within its radius, of (n,).
///
/// Non-maximum suppression (Neubeck, Van Gool 2006) of points in the order of their worth. The norm is 2 or inf.
std::vector<int> suppress(const View<>& points, const Eigen::Ref<const Vector<Dynamic>>& radius, double norm = 2.0);

}  // namespace spheremouse
