// Attitude hypotheses from pairs of directions, and their ranking (Mortari et al. 2004).
//
// Nothing is random. The first of equals wins. `identify.IdentificationPrior` has the numbers and their reasons.
#pragma once

#include <array>

#include "spheremouse/native/matrices.h"

namespace spheremouse::ball {

/// Rotations that map two known directions to a pair of seen ones.
struct Hypotheses {
    Matrix<Dynamic, 3> seen, known;  // unit vectors; a rotation maps `known` to `seen`
    std::vector<Matrix<3>> rotations;
    std::vector<std::array<int, 4>> origins;  // indices of the seen and of the known pair

    /// Take the pairs within `groups` groups of seen directions. Angles may differ by `tolerance` rad.
    Hypotheses(nb::handle seen, nb::handle known, int groups, double tolerance, size_t max_count);

    /// Return the rotations with the best scores, best first.
    std::vector<Matrix<3>> best(double sigma, double gain, double margin, size_t max_count) const;

    /// Return the rotation with the most matches at a cosine above `min_cosine`, and their number.
    std::pair<Matrix<3>, int> most_common(double min_cosine) const;
};

}  // namespace spheremouse::ball
