// Pairs of points and discs: predicted places, innovations, and the agreement of pairs with one another.
#include <limits>
#include <numeric>

#include "spheremouse/ball/filters/so3_steps.h"
#include "spheremouse/geometry/matching.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr int FIXED = MAP_OFFSET;    // errors before those of the discs
constexpr double NEAR = 0.99;        // cosine of 8 degrees, the largest distance of a pair with all considered errors
constexpr double NEARBY = 0.9;       // cosine of 26 degrees, the largest distance of a pair with any readout delay
constexpr double WIDE_SPREAD = 0.1;  // rad: an attitude known worse than that is not linear in any sense
constexpr double INFINITE = std::numeric_limits<double>::infinity();
using Dense = Matrix<Dynamic>;
using Indices = std::vector<int>;
using Noise = Matrix<CORE>;  // process noise that the covariance does not include yet

/// The ball as the filter predicts it: `So3State.body`.
struct Body {
    Matrix<3> attitude;
    Vector<3> rate, acceleration;
    View<Dynamic, 3> discs;
    Array<const double, -1, 3, 2> basis;
    View<> P;
    double readout;  // s, by which the rolling shutter takes longer than the rig says

    int size() const { return int(discs.rows()); }

    /// The turn from the stamp to `delay`, s, after it.
    Vector<3> turn(double delay) const { return rate * delay + 0.5 * acceleration * delay * delay; }
};

/// Points of a frame: `SpherePoints.measurement`.
struct Points {
    View<Dynamic, 3> direction;
    Array<const double, -1, 3, 3> covariance;  // m², of image noise
    Vector<Dynamic> delay;                     // s, with the estimated readout
    Eigen::Map<const Vector<Dynamic>> row;
    Array<const double, -1, 3, 6> by_pose;
    Array<const double, -1, 3, 4> by_ball;
    double radius;  // m

    int size() const { return int(direction.rows()); }

    /// Image noise of the direction, rad².
    Matrix<3> noise(int i) const { return View<3, 3>(covariance.data() + 9 * i) / (radius * radius); }
};

/// The innovations of k pairs, as `so3_update.cpp` takes them.
struct Innovation {
    Matrix<Dynamic, CORE> H;
    Dense HP;
    Vector<Dynamic> z;
    Dense S;
};

/// A disc as the camera sees it some time after the stamp.
struct Place {
    Vector<3> p;     // obj
    Matrix<3, 2> E;  // tangent axes, obj
    Matrix<2, 3> H;  // d z / d rotation error of z = E' b: a turn e moves p by e x p

    Place(const Body& body, int k, double delay) {
        const Matrix<3> R = delay == 0.0 ? body.attitude : Matrix<3>(exp(body.turn(delay)) * body.attitude);
        p = R * body.discs.row(k).transpose();
        E = R * View<3, 2>(body.basis.data() + 6 * k);
        for (int a = 0; a < 2; a++) H.row(a) = p.cross(Vector<3>(E.col(a))).transpose();
    }
};

/// Return the covariance of a disc's predicted place by the errors of rotation and disc.
Matrix<2> place_covariance(const View<>& P, const Matrix<2, 3>& H, int k, const Noise& added) {
    const int at = MAP_OFFSET + 2 * k;
    const Matrix<2> cross = H * P.block<3, 2>(0, at);
    return P.block<2, 2>(at, at) + cross + cross.transpose() +
           H * (P.topLeftCorner<3, 3>() + added.topLeftCorner<3, 3>()) * H.transpose();
}

/// Return d z / d (rotation, rate, acceleration, pose, ball, readout) of the point i.
Matrix<2, FIXED> jacobian(const Body& body, const Points& points, int i, const Place& place) {
    Matrix<2, FIXED> J = Matrix<2, FIXED>::Zero();
    const double t = points.delay(i);
    J.leftCols<3>() = place.H;
    if (t != 0.0) {
        const Vector<3> turn = body.turn(t);
        J.leftCols<3>() = place.H * exp(turn);
        J.middleCols<3>(3) = t * place.H * left_jacobian(turn);
        J.middleCols<3>(6) = 0.5 * t * J.middleCols<3>(3);
    }
    Matrix<3, 10> by_common;
    by_common << View<3, 6>(points.by_pose.data() + 18 * i), View<3, 4>(points.by_ball.data() + 12 * i);
    by_common.middleCols<3>(6) -= Matrix<3>::Identity();  // the direction counts from the centre
    J.middleCols<10>(CORE) = -place.E.transpose() * by_common / points.radius;
    J.col(READOUT) = place.H * body.rate * points.row(i);
    return J;
}

/// Return the covariance of a disc's predicted place by all that J depends on.
Matrix<2> full_covariance(const View<>& P, const Matrix<2, FIXED>& J, const Matrix<2, 3>& H, int k,
                          const Noise& added) {
    const int at = MAP_OFFSET + 2 * k;
    const Matrix<2, FIXED> HP = P.block<2, FIXED>(at, 0) + J * P.topLeftCorner<FIXED, FIXED>();
    return P.block<2, 2>(at, at) + J * P.block<FIXED, 2>(0, at) + HP * J.transpose() +
           H * added.topLeftCorner<3, 3>() * H.transpose();
}

/// Return the squared Mahalanobis distance of z with the covariance C.
double squared(const Vector<2>& z, const Matrix<2>& C) {
    const double determinant = C(0, 0) * C(1, 1) - C(0, 1) * C(0, 1);
    return (C(1, 1) * z(0) * z(0) - 2.0 * C(0, 1) * z(0) * z(1) + C(0, 0) * z(1) * z(1)) / determinant;
}

/// Return squared distances, (n, k), of points to the discs `which`, exact below `gate`.
///
/// Errors of the considered parameters alone reject no disc. Most pairs are one without them.
Dense distances(const Body& body, const Points& points, const Indices& which, const Noise& added, double allowance,
                double gate) {
    const bool any_considered = (body.P.diagonal().segment(CORE, MAP_OFFSET - CORE).array() > 0.0).any();
    Dense result = Dense::Constant(points.size(), nb::ssize_t(which.size()), INFINITE);
    for (size_t m = 0; m < which.size(); m++) {
        double delay = 0.0;
        Place place(body, which[m], delay);
        Matrix<2> S = place_covariance(body.P, place.H, which[m], added);
        S.diagonal().array() += allowance;
        for (int i = 0; i < points.size(); i++) {
            const Vector<3> b = points.direction.row(i);
            if (points.delay(i) != delay && place.p.dot(b) > NEARBY) {
                delay = points.delay(i);
                place = Place(body, which[m], delay);
            }
            const double cosine = place.p.dot(b);
            if (cosine < 0.0) continue;
            const Vector<2> z = place.E.transpose() * b;
            const Matrix<3> noise = points.noise(i);
            double& value = result(i, nb::ssize_t(m));
            if (z.squaredNorm() <= 4.0 * gate * (S.trace() + noise.trace()))  // most pairs are far apart
                value = squared(z, S + place.E.transpose() * noise * place.E);
            if (!(value >= gate && cosine > NEAR && (any_considered || delay != 0.0))) continue;
            Matrix<2> C = full_covariance(body.P, jacobian(body, points, i, place), place.H, which[m], added);
            C.diagonal().array() += allowance;
            value = squared(z, C + place.E.transpose() * noise * place.E);
        }
    }
    return result;
}

/// Return the variance, rad², of the terms that the linear model omits.
///
/// A turn e moves p by e x p + e (e . p) / 2 + ... At the start, with the rate unknown, the omitted terms exceed the
/// image noise many times. In tracking they are negligible.
double curvature(const View<>& P, const Noise& added) {
    const double spread = (P.topLeftCorner<3, 3>().trace() + added.topLeftCorner<3, 3>().trace()) / 3.0;
    return std::pow(std::min(spread, WIDE_SPREAD * WIDE_SPREAD), 2);
}

/// Add J P to C row by row, without the terms in which J or the variance of the error is zero: most are.
WIDE void add_product(const double* J, const double* P, int rows, int n, double* C) {
    for (int i = 0; i < rows; i++)
        for (int c = 0; c < FIXED; c++) {
            const double f = J[i * FIXED + c], *from = P + size_t(c) * n;
            if (f == 0.0 || !(from[c] > 0.0)) continue;
            double* to = C + size_t(i) * n;
            for (int j = 0; j < n; j++) to[j] += f * from[j];
        }
}

Innovation innovation(const Body& body, const Points& points, const Indices& rows, const Indices& columns,
                      double allowance) {
    const int k = int(rows.size()), n = int(body.P.rows());
    Matrix<Dynamic, FIXED> J(2 * k, FIXED);
    Innovation r{Matrix<Dynamic, CORE>(2 * k, CORE), Dense(2 * k, n), Vector<Dynamic>(2 * k), Dense(2 * k, 2 * k)};
    for (int i = 0; i < k; i++) {
        const Place place(body, columns[i], points.delay(rows[i]));
        J.middleRows<2>(2 * i) = jacobian(body, points, rows[i], place);
        r.z.segment<2>(2 * i) = place.E.transpose() * points.direction.row(rows[i]).transpose();
        r.HP.middleRows<2>(2 * i) = body.P.middleRows<2>(MAP_OFFSET + 2 * columns[i]);
        r.S.block<2, 2>(2 * i, 2 * i) = place.E.transpose() * points.noise(rows[i]) * place.E;
    }
    r.H = J.leftCols<CORE>();
    add_product(J.data(), body.P.data(), 2 * k, n, r.HP.data());
    for (int i = 0; i < 2 * k; i++)
        for (int j = 0; j <= i; j++) {
            const double noise = i / 2 == j / 2 ? r.S(i, j) + (i == j ? allowance : 0.0) : 0.0;
            r.S(i, j) = r.S(j, i) =
                noise + r.HP(i, MAP_OFFSET + 2 * columns[j / 2] + j % 2) + r.HP.row(i).head<FIXED>().dot(J.row(j));
        }
    return r;
}

/// Return a mask, (k,), of the pairs that agree with one another; each alone may pass the gate.
///
/// Data snooping (Baarda 1968, for pairs of coordinates) removes the pair that contradicts the others and the
/// prediction most, and repeats until all agree. Such a pair is a look-alike beside the place of a hidden disc, above
/// all after a gap.
std::vector<bool> consistent(const Vector<Dynamic>& z, const Dense& S, double limit) {
    std::vector<bool> keep(size_t(z.size()) / 2, true);
    Indices at(size_t(z.size()));
    std::iota(at.begin(), at.end(), 0);
    while (at.size() > 2) {
        const Eigen::LLT<Dense> llt(Dense(S(at, at)));
        if (llt.info() != Eigen::Success) break;
        const Dense L = llt.matrixL().solve(Dense::Identity(nb::ssize_t(at.size()), nb::ssize_t(at.size())));
        const Vector<Dynamic> v = L.transpose() * (L * z(at));
        int worst = -1;
        double most = limit;
        for (int i = 0; i < int(at.size()); i += 2) {
            const Matrix<2> inverse = L.middleCols<2>(i).transpose() * L.middleCols<2>(i);
            const double contradiction = squared(v.segment<2>(i), inverse);
            if (contradiction >= most) worst = i, most = contradiction;
        }
        if (worst < 0) break;
        keep[size_t(at[size_t(worst)]) / 2] = false;
        at.erase(at.begin() + worst, at.begin() + worst + 2);
    }
    return keep;
}

/// Return whether no row and no column has two distances below the gate.
bool unambiguous(const Dense& distance, double gate) {
    const auto hits = (distance.array() < gate).cast<int>().eval();
    return hits.size() == 0 || (hits.rowwise().sum().maxCoeff() <= 1 && hits.colwise().sum().maxCoeff() <= 1);
}

struct Pairs {
    Indices rows, columns;
    int possible;  // greatest number of pairs
    bool plain;    // no other pair was possible
    bool in_place, agree;
    Innovation innovation;  // of all pairs, with those that disagree
};

Pairs pair(const Body& body, const Points& points, const Vector<3>& towards, double horizon, const Noise& added,
           double gate) {
    Indices which;
    const Vector<3> to_camera = body.attitude.transpose() * towards;
    for (int k = 0; k < body.size(); k++)
        if (body.discs.row(k).dot(to_camera) > horizon) which.push_back(k);
    const double allowance = curvature(body.P, added);
    const Dense distance = distances(body, points, which, added, allowance, gate);
    const Indices column = match(gate - distance.array());
    Pairs r;
    double total = 0.0;
    for (int i = 0; i < points.size(); i++) {
        if (column[size_t(i)] < 0) continue;
        r.rows.push_back(i);
        r.columns.push_back(which[size_t(column[size_t(i)])]);
        total += distance(i, column[size_t(i)]);
    }
    r.possible = std::min(points.size(), int(which.size()));
    r.plain = unambiguous(distance, gate);
    r.innovation = innovation(body, points, r.rows, r.columns, allowance);
    const auto& [H, HP, z, S] = r.innovation;
    const std::vector<bool> keep = consistent(z, S + H * added * H.transpose(), 1.5 * gate);
    r.agree = std::all_of(keep.begin(), keep.end(), [](bool kept) { return kept; });
    r.in_place = r.agree && total < 4.0 * double(std::max<size_t>(r.rows.size(), 1)) + 10.0;
    for (size_t i = keep.size(); i-- > 0;)
        if (!keep[i]) r.rows.erase(r.rows.begin() + i), r.columns.erase(r.columns.begin() + i);
    return r;
}

// ---- for Python ----

Body read_body(nb::tuple body) {
    Body r{matrix<3, 3>(body[0], "attitude"),
           vector<3>(body[1], "rate"),
           vector<3>(body[2], "acceleration"),
           matrix<Dynamic, 3>(body[3], "discs"),
           array<const double, -1, 3, 2>(body[4], "basis"),
           matrix(body[5], "joint"),
           nb::cast<double>(body[6])};
    const nb::ssize_t m = r.discs.rows(), n = MAP_OFFSET + 2 * m + CLONE;
    if (nb::ssize_t(r.basis.shape(0)) != m) throw nb::type_error("basis: must have the length of discs");
    if (r.P.rows() != n || r.P.cols() != n)
        throw nb::type_error("joint: must be square, with 23 rows and two for each disc");
    return r;
}

Points read_points(nb::tuple points, double readout) {
    const auto row = vector(points[3], "row");
    Points r{matrix<Dynamic, 3>(points[0], "direction"),
             array<const double, -1, 3, 3>(points[1], "image_covariance"),
             vector(points[2], "delay"),
             row,
             array<const double, -1, 3, 6>(points[4], "dposition_dpose"),
             array<const double, -1, 3, 4>(points[5], "dposition_dball"),
             nb::cast<double>(points[6])};
    const size_t n = size_t(r.size());
    if (r.covariance.shape(0) != n || size_t(r.delay.size()) != n || size_t(row.size()) != n ||
        r.by_pose.shape(0) != n || r.by_ball.shape(0) != n)
        throw nb::type_error("points: must have one length");
    if (readout != 0.0) r.delay += readout * row;
    return r;
}

Indices read_indices(nb::handle given, const char* name, int size) {
    const auto indices = array<const int64_t, -1>(given, name);
    for (size_t i = 0; i < indices.shape(0); i++)
        if (indices(i) < 0 || indices(i) >= size) throw std::out_of_range(name);
    return Indices(indices.data(), indices.data() + indices.shape(0));
}

nb::tuple innovation_to_numpy(const Innovation& r) {
    return nb::make_tuple(to_numpy(r.H), to_numpy(r.HP), to_numpy(r.z), to_numpy(r.S));
}

nb::ndarray<nb::numpy, double> place_sigma(nb::tuple body_, nb::handle which_, nb::handle added_) {
    const Body body = read_body(body_);
    const Noise added = matrix<CORE, CORE>(added_, "added");
    const Indices which = read_indices(which_, "which", body.size());
    auto sigma = zeros<double>({which.size()});
    for (size_t i = 0; i < which.size(); i++) {
        const Matrix<2> S = place_covariance(body.P, Place(body, which[i], 0.0).H, which[i], added);
        const double half = std::hypot(0.5 * (S(0, 0) - S(1, 1)), S(0, 1));
        sigma.data()[i] = std::sqrt(std::max(0.5 * S.trace() + half, 0.0));
    }
    return sigma;
}

nb::ndarray<nb::numpy, double> distances_(nb::tuple body_, nb::tuple points_, nb::handle which_, nb::handle added_,
                                          double allowance, double gate) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body.readout);
    const Noise added = matrix<CORE, CORE>(added_, "added");
    return to_numpy(distances(body, points, read_indices(which_, "which", body.size()), added, allowance, gate));
}

nb::tuple innovation_(nb::tuple body_, nb::tuple points_, nb::handle rows_, nb::handle columns_) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body.readout);
    const Indices rows = read_indices(rows_, "rows", points.size());
    const Indices columns = read_indices(columns_, "columns", body.size());
    if (rows.size() != columns.size()) throw nb::type_error("columns: must have the length of rows");
    return innovation_to_numpy(innovation(body, points, rows, columns, curvature(body.P, Noise::Zero())));
}

nb::tuple pair_(nb::tuple body_, nb::tuple points_, nb::handle towards_, double horizon, nb::handle added_,
                double gate) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body.readout);
    const Vector<3> towards = vector<3>(towards_, "towards");
    const Noise added = matrix<CORE, CORE>(added_, "added");
    Pairs r;
    {
        nb::gil_scoped_release release;
        r = pair(body, points, towards, horizon, added, gate);
    }
    return nb::make_tuple(to_numpy(r.rows), to_numpy(r.columns), r.possible, r.plain, r.in_place, r.agree,
                          innovation_to_numpy(r.innovation));
}

}  // namespace

void bind_so3_match(nb::module_& m) {
    m.def("place_sigma", &place_sigma, arg("body"), arg("which"), arg("added"));
    m.def("distances", &distances_, arg("body"), arg("points"), arg("which"), arg("added"), arg("allowance"),
          arg("gate"));
    m.def("innovation", &innovation_, arg("body"), arg("points"), arg("rows"), arg("columns"));
    m.def("pair", &pair_, arg("body"), arg("points"), arg("towards"), arg("horizon"), arg("added"), arg("gate"));
}

}  // namespace spheremouse::ball
