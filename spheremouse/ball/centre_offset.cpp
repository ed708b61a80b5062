// The shift of the ball's centre that the discs of one frame show, as `centre_offset.py` describes it.
#include <optional>

#include "spheremouse/ball/filters/so3.h"
#include "spheremouse/geometry/matching.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr double PRIOR = 0.1;   // radii, standard deviation of a shift before anything is seen
constexpr double LEAST = 1e-9;  // 1/rad², information about a turn; both keep the equations solvable
constexpr int FEWEST = 4;       // pairs, since any shift fits three
// rad, standard deviation of a disc's place on the map and in the picture that no view removes
constexpr double PLACE_SIGMA = 5e-4;

struct RotatedDiscs {
    Matrix<Dynamic, 3> place;  // obj
    Eigen::Map<const Vector<Dynamic>> variance;
    Vector<3> rate;
};

struct Offset {
    int pairs;
    Vector<3> shift;  // radii, obj
    Matrix<3> covariance;
    double mahalanobis_squared, rotation, with_offset;  // of `shift` from zero; chi-squares per degree of freedom
};

/// Return the shift of the centre from its assumed place, by least squares over turn and shift, if it has a solution.
std::optional<Offset> offset(const Points& points, const RotatedDiscs& discs, double reach) {
    const Matrix<Dynamic> cosine = points.direction * discs.place.transpose();
    const std::vector<int> column =
        mutual_nearest((cosine.array() > std::cos(reach)).select(1.0 - cosine.array(), HUGE_VAL));
    Matrix<6> N = Matrix<6>::Zero();
    N.diagonal() << Vector<3>::Constant(LEAST), Vector<3>::Constant(1.0 / (PRIOR * PRIOR));
    Vector<6> right = Vector<6>::Zero();
    double total = 0.0;
    int k = 0;
    for (int i = 0; i < int(column.size()); i++) {
        if (column[size_t(i)] < 0) continue;
        k++;
        const Vector<3> p = discs.place.row(column[size_t(i)]);
        // the place when the row was exposed
        const Vector<3> z = points.direction.row(i).transpose() - p - points.delay(i) * discs.rate.cross(p);
        Matrix<3, 6> A;
        A << -hat(p), -points.radius * points.by_rig(i).rightCols<3>();
        Matrix<3> C = points.noise(i);
        C.diagonal().array() += discs.variance(column[size_t(i)]) + PLACE_SIGMA * PLACE_SIGMA;
        const Matrix<3> W = C.inverse();
        N += A.transpose() * W * A;
        right += A.transpose() * W * z;
        total += z.dot(W * z);
    }
    if (k < FEWEST) return {};
    const Vector<3> turn = N.topLeftCorner<3, 3>().inverse() * right.head<3>();
    const Matrix<6> Q = N.inverse();
    const Vector<6> x = Q * right;
    const double squared = x.tail<3>().dot(Q.bottomRightCorner<3, 3>().inverse() * x.tail<3>());
    // discs that are all in one place do not tell a shift from a turn
    if (!std::isfinite(squared + turn.sum())) return {};
    return Offset{k,
                  x.tail<3>(),
                  Q.bottomRightCorner<3, 3>(),
                  std::max(squared, 0.0),
                  std::max(total - right.head<3>().dot(turn), 0.0) / (2 * k - 3),
                  std::max(total - right.dot(x), 0.0) / (2 * k - 6)};
}

nb::object shift_of(nb::tuple points_, nb::handle delay, nb::tuple discs_, double reach) {
    members(discs_, 4, "discs");
    Points points = read_points(points_);
    const auto late = vector(delay, "delay");
    if (late.size() != points.size()) throw nb::type_error("delay: must have the length of points");
    points.delay = late;
    const auto directions = matrix<Dynamic, 3>(discs_[0], "directions");
    const Matrix<3> attitude = matrix<3, 3>(discs_[2], "attitude");
    const RotatedDiscs discs{directions * attitude.transpose(), vector(discs_[1], "variance"),
                             vector<3>(discs_[3], "rate")};
    if (discs.variance.size() != directions.rows())
        throw nb::type_error("variance: must have the length of directions");
    const auto r = offset(points, discs, reach);
    if (!r) return nb::none();
    return nb::make_tuple(r->pairs, to_numpy(Vector<3>(points.radius * r->shift)),
                          to_numpy(Matrix<3>(points.radius * points.radius * r->covariance)),
                          std::sqrt(r->mahalanobis_squared), r->rotation, r->with_offset);
}

}  // namespace

void bind_centre_offset(nb::module_& m) {
    m.def("shift_of", &shift_of, arg("points"), arg("delay"), arg("discs"), arg("reach"));
}

}  // namespace spheremouse::ball
