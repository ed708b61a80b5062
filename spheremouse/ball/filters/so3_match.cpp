// Pairs of points and discs: predicted places, innovations, and the agreement of pairs with one another.
#include <limits>
#include <numeric>

#include "spheremouse/ball/filters/so3.h"
#include "spheremouse/geometry/matching.h"

namespace spheremouse::ball {
namespace {

constexpr double NEAR = 0.99;        // cosine of 8 degrees, the largest distance of a pair with all considered errors
constexpr double NEARBY = 0.9;       // cosine of 26 degrees, the largest distance of a pair with any readout delay
constexpr double WIDE_SPREAD = 0.1;  // rad: an attitude known worse than that is not linear in any sense
constexpr double DETECTED = 0.8;     // probability that a disc in view is seen: hands and struts hide some
constexpr int MOST_OTHERS = 100;     // cameras
constexpr double INFINITE = std::numeric_limits<double>::infinity();
/// Return the covariance of a disc's predicted place by the errors of rotation and disc.
Matrix<2> place_covariance(const Body& body, const Matrix<2, 3>& H, int k, const Noise& added) {
    const View<>& P = body.P;
    const int at = body.map_row() + 2 * k;
    const Matrix<2> cross = H * P.block<3, 2>(0, at);
    return P.block<2, 2>(at, at) + cross + cross.transpose() +
           H * (P.topLeftCorner<3, 3>() + added.topLeftCorner<3, 3>()) * H.transpose();
}

/// Return the rows of P, from the column `at` on, of the errors in the order of the Jacobian.
template <int width>
Matrix<FIXED, width> fixed_rows(const Body& body, int at) {
    Matrix<FIXED, width> rows;
    rows << body.P.block<READOUT, width>(0, at), body.P.block<1, width>(body.readout_row(), at);
    return rows;
}

/// Return the covariance of the errors in the order of the Jacobian.
Matrix<FIXED> fixed_covariance(const Body& body) {
    Matrix<FIXED> C;
    C << fixed_rows<READOUT>(body, 0), fixed_rows<1>(body, body.readout_row());
    return C;
}

/// Return the covariance of a disc's predicted place by all that J depends on; `fixed` is `fixed_covariance`.
Matrix<2> full_covariance(const Body& body, const Matrix<FIXED>& fixed, const Matrix<2, FIXED>& J,
                          const Matrix<2, 3>& H, int k, const Noise& added) {
    const int at = body.map_row() + 2 * k;
    const Matrix<FIXED, 2> with_disc = fixed_rows<2>(body, at);
    const Matrix<2, FIXED> HP = with_disc.transpose() + J * fixed;
    return body.P.block<2, 2>(at, at) + J * with_disc + HP * J.transpose() +
           H * added.topLeftCorner<3, 3>() * H.transpose();
}

/// Return the squared Mahalanobis distance of z with the covariance C.
double squared(const Vector<2>& z, const Matrix<2>& C) {
    const double determinant = C(0, 0) * C(1, 1) - C(0, 1) * C(0, 1);
    return (C(1, 1) * z(0) * z(0) - 2.0 * C(0, 1) * z(0) * z(1) + C(0, 0) * z(1) * z(1)) / determinant;
}

/// Return the variance, rad², of the attitude, at most that of a wide spread.
double spread(const View<>& P, const Noise& added) {
    const double variance = (P.topLeftCorner<3, 3>().trace() + added.topLeftCorner<3, 3>().trace()) / 3.0;
    return std::min(variance, WIDE_SPREAD * WIDE_SPREAD);
}

/// Return the variance, rad², of the terms that the linear model omits.
///
/// A turn e moves p by e x p + e (e . p) / 2 + ... At the start, with the rate unknown, the omitted terms exceed the
/// image noise many times. In tracking they are negligible.
double curvature(const View<>& P, const Noise& added) { return std::pow(spread(P, added), 2); }

/// Add J P to C row by row, without the terms in which J or the variance of the error is zero: most are.
///
/// The row `readout` of P is that of the last column of J.
WIDE void add_product(const double* J, const double* P, int readout, int rows, int n, double* C) {
    for (int i = 0; i < rows; i++)
        for (int c = 0; c < FIXED; c++) {
            const int at = c == READOUT ? readout : c;
            const double f = J[i * FIXED + c], *from = P + size_t(at) * n;
            if (f == 0.0 || !(from[at] > 0.0)) continue;
            double* to = C + size_t(i) * n;
            for (int j = 0; j < n; j++) to[j] += f * from[j];
        }
}

struct Agreement {
    std::vector<bool> keep;  // pairs that agree with one another; each alone may pass the gate
    double widest = 0.0;     // rad², as in `Pairs`
};

/// Return the pairs that agree with one another.
///
/// Data snooping (Baarda 1968, for pairs of coordinates) removes the pair that contradicts the others and the
/// prediction most, and repeats until all agree. Such a pair is a look-alike beside the place of a hidden disc, above
/// all after a gap.
Agreement consistent(const Each& z, const Dense& S, double limit) {
    Agreement r{std::vector<bool>(size_t(z.size()) / 2, true)};
    Indices at(size_t(z.size()));
    std::iota(at.begin(), at.end(), 0);
    while (at.size() > 2) {
        const Eigen::LLT<Dense> llt(Dense(S(at, at)));
        if (llt.info() != Eigen::Success) break;
        const Dense L = llt.matrixL().solve(Dense::Identity(nb::ssize_t(at.size()), nb::ssize_t(at.size())));
        const Each v = L.transpose() * (L * z(at));
        int worst = -1;
        double most = limit;
        r.widest = 0.0;
        for (int i = 0; i < int(at.size()); i += 2) {
            const Matrix<2> inverse = L.middleCols<2>(i).transpose() * L.middleCols<2>(i);
            r.widest = std::max(r.widest, 1.0 / std::sqrt(inverse.determinant()));
            const double contradiction = squared(v.segment<2>(i), inverse);
            if (contradiction >= most) worst = i, most = contradiction;
        }
        if (worst < 0) break;
        r.keep[size_t(at[size_t(worst)]) / 2] = false;
        at.erase(at.begin() + worst, at.begin() + worst + 2);
    }
    return r;
}

/// Return the log likelihood ratio of pairs to that of no pair.
///
/// A point that is no disc lies anywhere on the visible cap. A wide gate finds pairs by chance, and a low density
/// weighs them accordingly (Reid 1979, eq. 16).
double log_likelihood(const Innovation& seen, const Noise& added, double foreign) {
    const Eigen::LLT<Dense> L(seen.S + seen.H * added * seen.H.transpose());
    if (L.info() != Eigen::Success) throw std::domain_error("covariance of the innovations is not positive definite");
    const Each white = L.matrixL().solve(seen.z);
    return -0.5 * white.squaredNorm() - L.matrixLLT().diagonal().array().log().sum() +
           0.5 * double(white.size()) * std::log(DETECTED / ((1.0 - DETECTED) * foreign * 2.0 * M_PI));
}

/// Return whether no row and no column has two distances below the gate.
bool unambiguous(const Dense& distance, double gate) {
    const auto hits = (distance.array() < gate).cast<int>().eval();
    return hits.size() == 0 || (hits.rowwise().sum().maxCoeff() <= 1 && hits.colwise().sum().maxCoeff() <= 1);
}

}  // namespace

Place::Place(const Body& body, int k, double delay)
    : Place(body.discs.row(k), View<3, 2>(body.basis.row(k).data()),
            delay == 0.0 ? body.attitude : Matrix<3>(exp(body.turn(delay)) * body.attitude)) {}

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
    J.middleCols<3>(AXES) = -place.H;  // a turn of the axes moves the direction of the point
    J.middleCols<RIG_DIM>(RIG) = -place.E.transpose() * points.by_rig(i);
    J.middleCols<3>(ECCENTRICITY) = J.middleCols<3>(RIG + 1) * body.attitude;
    J.col(READOUT) = place.H * body.rate * points.row(i);
    return J;
}

Matrix<Dynamic, FIXED> fixed_columns(const Dense& A, const Body& body) {
    Matrix<Dynamic, FIXED> columns(A.rows(), FIXED);
    columns << A.leftCols<READOUT>(), A.col(body.readout_row());
    return columns;
}

Body read_body(nb::tuple body) {
    members(body, 12, "body");
    Body r{matrix<3, 3>(body[0], "attitude"),    vector<3>(body[1], "rate"),       vector<3>(body[2], "acceleration"),
           matrix<Dynamic, 3>(body[3], "discs"), matrices<3, 2>(body[4], "basis"), matrix(body[5], "joint"),
           number<double>(body[6], "body"),      vector<RIG_DIM>(body[7], "rig"),  vector<3>(body[11], "eccentricity"),
           number<int>(body[8], "body"), number<int>(body[9], "body") != 0,    number<int>(body[10], "body")};
    if (r.others < 0 || r.others > MOST_OTHERS) throw nb::type_error("others: must be at least 0, and few");
    const nb::ssize_t m = r.discs.rows(), n = r.map_row() + 2 * m + CLONE;
    if (r.basis.rows() != m) throw nb::type_error("basis: must have the length of discs");
    if (r.known < 0 || r.known > m) throw nb::type_error("known: must be at most the length of discs");
    if (r.P.rows() != n || r.P.cols() != n)
        throw nb::type_error("joint: must be square, with 23 rows, 8 for each other camera and two for each disc");
    return r;
}

Points read_points(nb::tuple points) {
    members(points, 7, "points");
    const auto row = vector(points[3], "row");
    Points r{Matrix<Dynamic, 3>(matrix<Dynamic, 3>(points[0], "direction")),
             matrices<3, 3>(points[1], "image_covariance"),
             vector(points[2], "delay"),
             row,
             matrices<3, RIG_DIM>(points[4], "ddirection_drig"),
             number<double>(points[5], "points"),
             vector<RIG_DIM>(points[6], "rig")};
    for (nb::ssize_t n : {r.covariance.rows(), r.delay.size(), row.size(), r.ddirection_drig.rows()})
        if (n != r.size()) throw nb::type_error("points: must have one length");
    return r;
}

Points read_points(nb::tuple points, const Body& body) {
    Points r = read_points(points);
    if (body.readout != 0.0) r.delay += body.readout * r.row;
    const Vector<RIG_DIM> change = body.seen_rig() - r.rig;
    if (change.squaredNorm() > 0.0)
        for (int i = 0; i < r.size(); i++)
            r.direction.row(i) = (r.direction.row(i).transpose() + r.by_rig(i) * change).normalized();
    return r;
}

Indices read_indices(nb::handle given, const char* name, int size) {
    const auto indices = array<const int64_t, -1>(given, name);
    for (size_t i = 0; i < indices.shape(0); i++)
        if (indices(i) < 0 || indices(i) >= size) throw std::out_of_range(name);
    return Indices(indices.data(), indices.data() + indices.shape(0));
}

Pairs read_pairs(nb::handle rows, nb::handle columns, const Body& body, const Points& points) {
    Pairs r;
    r.rows = read_indices(rows, "rows", points.size());
    r.columns = read_indices(columns, "columns", body.size());
    if (r.rows.size() != r.columns.size()) throw nb::type_error("columns: must have the length of rows");
    return r;
}

Viewer read_camera(nb::tuple camera) {
    members(camera, 2, "camera");
    return {vector<3>(camera[0], "towards"), number<double>(camera[1], "camera"), Matrix<3>::Zero()};
}

double place_variance(const Body& body, int k, const Noise& added) {
    const Matrix<2> S = place_covariance(body, Place(body, k, 0.0).H, k, added);
    return std::max(0.5 * S.trace() + std::hypot(0.5 * (S(0, 0) - S(1, 1)), S(0, 1)), 0.0);
}

Indices visible(const Body& body, const Viewer& viewer) {
    const Vector<3> to_camera = body.attitude.transpose() * viewer.towards;
    Indices which;
    for (int k = 0; k < body.known; k++)
        if (body.discs.row(k).dot(to_camera) > viewer.horizon) which.push_back(k);
    return which;
}

Dense distances(const Body& body, const Points& points, const Indices& which, const Noise& added, double allowance,
                double gate) {
    const Matrix<FIXED> fixed = fixed_covariance(body);
    const bool any_considered = (fixed.diagonal().tail<FIXED - CORE>().array() > 0.0).any();
    Dense result = Dense::Constant(points.size(), nb::ssize_t(which.size()), INFINITE);
    for (size_t m = 0; m < which.size(); m++) {
        double delay = 0.0;
        Place place(body, which[m], delay);
        Matrix<2> S = place_covariance(body, place.H, which[m], added);
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
            Matrix<2> C = full_covariance(body, fixed, jacobian(body, points, i, place), place.H, which[m], added);
            C.diagonal().array() += allowance;
            value = squared(z, C + place.E.transpose() * noise * place.E);
        }
    }
    return result;
}

Innovation innovation(const Body& body, const Points& points, const Pairs& pairs, const Noise& added) {
    const Indices &rows = pairs.rows, &columns = pairs.columns;
    const int k = int(rows.size()), n = int(body.P.rows());
    const double turned = spread(body.P, added);
    Matrix<Dynamic, FIXED> J(2 * k, FIXED);
    Innovation r{Matrix<Dynamic, CORE>(2 * k, CORE), Dense(2 * k, n), Each(2 * k), Dense(2 * k, 2 * k)};
    Each image(k);  // rad², traces of the noise
    for (int i = 0; i < k; i++) {
        const Place place(body, columns[i], points.delay(rows[i]));
        J.middleRows<2>(2 * i) = jacobian(body, points, rows[i], place);
        r.z.segment<2>(2 * i) = place.E.transpose() * points.direction.row(rows[i]).transpose();
        r.HP.middleRows<2>(2 * i) = body.P.middleRows<2>(body.map_row() + 2 * columns[i]);
        r.S.block<2, 2>(2 * i, 2 * i) = place.E.transpose() * points.noise(rows[i]) * place.E;
        image(i) = r.S.block<2, 2>(2 * i, 2 * i).trace();
    }
    r.H = J.leftCols<CORE>();
    add_product(J.data(), body.P.data(), body.readout_row(), 2 * k, n, r.HP.data());
    const Matrix<Dynamic, FIXED> fixed = fixed_columns(r.HP, body);
    for (int i = 0; i < 2 * k; i++)
        for (int j = 0; j <= i; j++) {
            const double noise = i / 2 == j / 2 ? r.S(i, j) : 0.0;
            r.S(i, j) = r.S(j, i) =
                noise + r.HP(i, body.map_row() + 2 * columns[j / 2] + j % 2) + fixed.row(i).dot(J.row(j));
        }
    // the part of a turn that a disc shares moves neither its place nor the omitted terms
    for (int i = 0; i < 2 * k; i += 2) {
        const auto H = r.H.middleRows<2>(i);
        const double own = 0.5 * (r.S.block<2, 2>(i, i).trace() - image(i / 2) + (H * added * H.transpose()).trace());
        r.S.block<2, 2>(i, i).diagonal().array() += turned * std::clamp(own, 0.0, turned);
    }
    return r;
}

namespace {

/// Return the pairs of least total distance at a level.
///
/// Each pair alone may pass the gate. A pair that contradicts the others is left out.
Pairs pair(const Body& body, const Points& points, const Viewer& viewer, const Pending& pending, double noise_scale,
           double gate) {
    const Noise added = pending.added(noise_scale);
    const Indices which = visible(body, viewer);
    const Dense distance = distances(body, points, which, added, curvature(body.P, added), gate);
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
    r.innovation = innovation(body, points, r, added);
    const auto& [H, HP, z, S] = r.innovation;
    const auto [keep, widest] = consistent(z, S + H * added * H.transpose(), 1.5 * gate);
    r.widest = widest;
    r.agree = std::all_of(keep.begin(), keep.end(), [](bool kept) { return kept; });
    r.in_place = r.agree && total < 4.0 * double(std::max<size_t>(r.rows.size(), 1)) + 10.0;
    if (r.agree) {
        r.noise_scale = noise_scale;
        return r;
    }
    for (size_t i = keep.size(); i-- > 0;)
        if (!keep[i]) r.rows.erase(r.rows.begin() + i), r.columns.erase(r.columns.begin() + i);
    r.innovation = innovation(body, points, r, Noise::Zero());
    return r;
}

}  // namespace

Pairs expected_pairs(const Body& body, const Points& points, const Viewer& viewer, const Pending& pending,
                     const Activity& activity) {
    return pair(body, points, viewer, pending, pending.weights.dot(activity.squares()), activity.gate);
}

Pairs likeliest_pairs(Pairs best, const Body& body, const Points& points, const Viewer& viewer, const Pending& pending,
                      const Activity& activity) {
    if (best.complete() || pending.process(3, 3) == 0.0) return best;
    const Each squares = activity.squares();
    const double expected = pending.weights.dot(squares);
    const double foreign = points.size() / (2.0 * M_PI * (1.0 - viewer.horizon));  // 1/rad², points that are no disc
    double most = log_likelihood(best.innovation, pending.added(expected), foreign);
    for (int k = 0; k < squares.size() && !best.complete(); k++) {
        if (squares(k) <= expected) continue;
        Pairs pairs = pair(body, points, viewer, pending, squares(k), activity.gate);
        const double value = log_likelihood(pairs.innovation, pending.added(squares(k)), foreign) +
                             std::log(std::max(pending.weights(k), 1e-12));
        if (value > most) best = std::move(pairs), most = value;
    }
    return best;
}

nb::tuple pairs_to_numpy(const Pairs& r) {
    return nb::make_tuple(to_numpy(r.rows), to_numpy(r.columns), r.complete(), r.noise_scale);
}

namespace {

NewArray<double> place_sigma(nb::tuple body_, nb::handle which_, nb::handle added_) {
    const Body body = read_body(body_);
    const Noise added = matrix<CORE, CORE>(added_, "added");
    const Indices which = read_indices(which_, "which", body.size());
    auto sigma = zeros<double>({which.size()});
    for (size_t i = 0; i < which.size(); i++) sigma.data()[i] = std::sqrt(place_variance(body, which[i], added));
    return sigma;
}

NewArray<double> distances_(nb::tuple body_, nb::tuple points_, nb::handle which_, nb::handle added_, double allowance,
                            double gate) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body);
    const Noise added = matrix<CORE, CORE>(added_, "added");
    return to_numpy(distances(body, points, read_indices(which_, "which", body.size()), added, allowance, gate));
}

nb::tuple innovation_(nb::tuple body_, nb::tuple points_, nb::handle rows, nb::handle columns, nb::handle added_) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body);
    const Noise added = matrix<CORE, CORE>(added_, "added");
    const auto [H, HP, z, S] = innovation(body, points, read_pairs(rows, columns, body, points), added);
    return nb::make_tuple(to_numpy(H), to_numpy(HP), to_numpy(z), to_numpy(S));
}

nb::tuple nearest_pairs(nb::tuple body_, nb::tuple points_, nb::tuple camera, nb::tuple pending_, nb::tuple activity_) {
    const Body body = read_body(body_);
    const Points points = read_points(points_, body);
    const Activity activity = read_activity(activity_);
    const Pending pending = read_pending(pending_, body, activity);
    const Viewer viewer = read_camera(camera);
    Pairs r;
    {
        nb::gil_scoped_release release;
        r = expected_pairs(body, points, viewer, pending, activity);
        r = likeliest_pairs(std::move(r), body, points, viewer, pending, activity);
    }
    return pairs_to_numpy(r);
}

}  // namespace

void bind_so3_match(nb::module_& m) {
    m.def("place_sigma", &place_sigma, arg("body"), arg("which"), arg("added"));
    m.def("distances", &distances_, arg("body"), arg("points"), arg("which"), arg("added"), arg("allowance"),
          arg("gate"));
    m.def("innovation", &innovation_, arg("body"), arg("points"), arg("rows"), arg("columns"), arg("added"));
    m.def("nearest_pairs", &nearest_pairs, arg("body"), arg("points"), arg("camera"), arg("pending"), arg("activity"));
}

}  // namespace spheremouse::ball
