// Anchors of the learnt picture as points of an image.
#include "spheremouse/ball/ball_view.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {
namespace {

constexpr double SAME = 1e-5;     // rad, of a rotation about an anchor: it is that of the whole alignment
constexpr double UNKNOWN = 10.0;  // rad, standard deviation of a rotation about an axis that no pixel shows

/// The errors of an anchor's place, rad.
struct AnchorErrors {
    double loose;   // standard deviation above which the pixels around an anchor do not determine its place
    double prior;   // of its place relative to the whole alignment
    double shared;  // of the learnt picture, common to the pixels around an anchor
    double tilted;  // of the whole alignment, by a turn about an axis that no pixel shows, and that is known badly
};

/// Return two orthonormal columns perpendicular to a unit vector, as `rotation.py` has them (Duff et al. 2017).
Matrix<3, 2> tangent_basis(const Vector<3>& u) {
    const double sign = std::copysign(1.0, u(2)), a = -1.0 / (sign + u(2)), b = u(0) * u(1) * a;
    Matrix<3, 2> E;
    E << 1.0 + sign * u(0) * u(0) * a, b, sign * b, sign + u(1) * u(1) * a, -sign * u(0), -u(1);
    return E;
}

double largest_eigenvalue(const Matrix<2>& H) {
    return 0.5 * (H.trace() + std::hypot(H(0, 0) - H(1, 1), 2.0 * H(0, 1)));
}

/// Return the inverse of a symmetric matrix with eigenvalues of any size, each at least `least`.
Matrix<3> inverse(const Matrix<3>& A, double least = 1e-30) {
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> found{Eigen::Matrix3d(A)};
    const Vector<3> values = found.eigenvalues().cwiseMax(least);
    return found.eigenvectors() * values.cwiseInverse().asDiagonal() * found.eigenvectors().transpose();
}

/// Return the information, rad^-2 in obj, on the rotation of an anchor's surroundings before their pixels are seen.
///
/// It is that of the whole alignment, with an error `sigma` about the columns of `E`. About the axes that `others`
/// projects to, nothing is known.
Matrix<3> prior_information(const Matrix<3, 2>& E, double sigma, const Matrix<3>& others) {
    const Matrix<3> known = inverse(sigma * sigma * E * E.transpose() + SAME * SAME * Matrix<3>::Identity());
    const Matrix<3> taken = known * others, rest = Matrix<3>::Identity() - others;
    return known - taken * inverse(others * taken + known.trace() * rest) * taken.transpose();
}

/// Return the anchors in view whose surroundings a frame shows: places, px, covariances, px², and indices.
///
/// The pixels around an anchor give a rotation of their own about the two axes across it, relative to the alignment of
/// the whole. `facing` has the direction of the camera, and the least cosine with it.
nb::tuple anchor_points(nb::handle anchors_, nb::handle R_, nb::handle information_, nb::handle gradient_,
                        nb::tuple errors_, nb::handle known_, nb::tuple facing, nb::handle view_) {
    const auto anchors = array<const double, -1, 3>(anchors_, "anchors"),
               gradient = array<const double, -1, 3>(gradient_, "gradient");
    const auto information = array<const double, -1, 3, 3>(information_, "information");
    const size_t n = anchors.shape(0);
    if (gradient.shape(0) != n || information.shape(0) != n)
        throw nb::type_error("information, gradient: must have one element for each anchor");
    const Matrix<3> R = matrix<3, 3>(R_, "R");
    members(errors_, 4, "errors");
    const Matrix<3> known = matrix<3, 3>(known_, "known");
    members(facing, 2, "facing");
    const AnchorErrors errors{number<double>(errors_[0], "errors"), number<double>(errors_[1], "errors"),
                              number<double>(errors_[2], "errors"), number<double>(errors_[3], "errors")};
    const Vector<3> towards = vector<3>(facing[0], "facing");
    const double horizon = number<double>(facing[1], "facing");
    const BallView view = read_ball_view(view_);
    const Matrix<3> others = Matrix<3>::Identity() - known;
    double in_view = 0.0;
    for (size_t k = 0; k < n; k++) in_view += (R * View<3, 1>(&anchors(k, 0))).dot(towards) > horizon;
    // The filter takes anchors for independent, so each has as many times the variance that all share.
    const Matrix<3> tilted = in_view * errors.tilted * errors.tilted * known;
    std::vector<size_t> which;
    std::vector<Vector<2>> places;
    std::vector<Matrix<2>> covariances;
    for (size_t k = 0; k < n; k++) {
        const Vector<3> b = R * View<3, 1>(&anchors(k, 0));
        if (!(b.dot(towards) > horizon)) continue;
        const Matrix<3, 2> E = tangent_basis(b);
        const Matrix<2> H = E.transpose() * View<3, 3>(information.data() + 9 * k) * E;
        if (!(largest_eigenvalue(H) > 1.0 / (errors.loose * errors.loose))) continue;
        const Matrix<3> own = View<3, 3>(information.data() + 9 * k);
        const Matrix<3, 2> gain =
            inverse(own + prior_information(E, errors.prior, others), 1.0 / (UNKNOWN * UNKNOWN)) * E;
        const Matrix<2> one = Matrix<2>::Identity(), C = E.transpose() * gain;
        const Vector<3> at = exp(E * gain.transpose() * View<3, 1>(&gradient(k, 0))) * b;
        const Matrix<3> to_cam = view.rotation.transpose();
        const Mapped<3> seen = project(view.camera, to_cam * (view.centre - view.position + view.radius * at));
        const Matrix<2> J = -view.radius * seen.J * to_cam * hat(at) * E;
        const Matrix<2> shared = errors.shared * errors.shared * one + E.transpose() * tilted * E;
        const Matrix<2> covariance = J * (C + shared) * J.transpose();
        which.push_back(k);
        places.push_back(seen.place);
        covariances.push_back(0.5 * (covariance + covariance.transpose()));
    }
    const Rows<2> place(which.size());
    const Rows<2, 2> covariance(which.size());
    for (size_t i = 0; i < which.size(); i++) place[i] = places[i], covariance[i] = covariances[i];
    return nb::make_tuple(place.array, covariance.array, to_numpy(which));
}

}  // namespace

void bind_anchors(nb::module_& m) {
    m.def("anchor_points", &anchor_points, arg("anchors"), arg("R"), arg("information"), arg("gradient"), arg("errors"),
          arg("known"), arg("facing"), arg("view"));
}

}  // namespace spheremouse::ball
