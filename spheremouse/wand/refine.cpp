// Refinement of a pose to a peak of the likelihood by Gauss-Newton steps, with its curvature. `likelihood.py` has the
// terms.
#include "spheremouse/wand/kernels.h"

namespace spheremouse::wand {
namespace {

using Edges = Array<const double, DIRECTIONS, 5>;

constexpr double CONVERGED = 0.01;                          // `slope` of a peak: a tenth of a standard deviation off
constexpr double COARSE_SIGMAS[] = {0.6, 0.4, 0.25, 0.13};  // of the field's range, in the first rounds

/// Residuals of all points and of the outline at one pose, with the weights, expected fields and slopes of the points.
struct Residuals {
    Eigen::VectorXd w, r, e, g, outline;
};

/// Refinement of one pose: the unknowns are the pose, the common offset of each colour's rims, and that of the outline.
class Refinement {
  public:
    Refinement(const BallModel& ball, const FieldsView& fields, const Edges& edges, const Pose& start)
        : pose(start),
          ball_(ball),
          fields_(fields),
          edges_(edges),
          sight_(ball.size),
          colours_(fields.rim.size()),
          offsets_(Eigen::VectorXd::Zero(Eigen::Index(colours_) + 1)) {}

    /// Take at most `rounds` steps. Return twice the gain in log-likelihood that a further round promises.
    double run(int rounds) {
        for (int round = 0;; round++) {
            const bool coarse = round < rounds - 4;
            linearise();
            assemble(coarse ? std::max(COARSE_SIGMAS[std::min(round, 3)], fields_.sigma) : fields_.sigma, coarse);
            const Eigen::VectorXd dx = A_.ldlt().solve(b_);
            if (round == rounds || (!coarse && !(dx.dot(b_) >= CONVERGED))) return dx.dot(b_);
            step(dx);
        }
    }

    Matrix<6> covariance() const {
        Matrix<6> full = Matrix<6>::Identity();
        full.topLeftCorner<3, 3>() = ray_basis(pose.c);
        return full * A_.inverse().topLeftCorner<6, 6>() * full.transpose();
    }

    /// Offsets of each colour's rims, px of the field outward.
    Eigen::VectorXd rims() const { return offsets_.head(Eigen::Index(colours_)); }

    Pose pose;

  private:
    void evaluate(const Pose& at, bool outline, Residuals& out) {
        const auto n = Eigen::Index(ball_.size);
        measure(ball_, fields_, at, nullptr, sight_);
        out.w.setZero(n), out.r.setZero(n), out.e.setZero(n), out.g.setZero(n);
        for (size_t i = 0; i < sight_.coloured; i++) {
            const auto q = Eigen::Index(sight_.index[i]);
            out.w[q] = sight_.w[i], out.r[q] = sight_.r[i], out.g[q] = sight_.g[i];
            out.e[q] = sight_.m[i] - sight_.r[i];
        }
        for (size_t i = 0; i < sight_.bare; i++) {  // the greatest field of all colours
            const auto q = Eigen::Index(sight_.bare_index[i]);
            out.w[q] = sight_.bare_w[i];
            for (size_t k = 0; k < colours_; k++)
                out.r[q] = std::max(out.r[q], fields_.weight.at(int(k), sight_.bare_x[i], sight_.bare_y[i]));
        }
        if (!outline) return;
        out.outline.setZero(DIRECTIONS);
        for (size_t k = 0; k < DIRECTIONS; k++) {
            if (edges_(k, 4) <= 0.0) continue;
            const Vector2d d =
                Vector2d(edges_(k, 0), edges_(k, 1)) - pixel(ball_.camera, at.c + outline_point(at.c, ball_.radius, k));
            out.outline[Eigen::Index(k)] = d.dot(Vector2d(edges_(k, 2), edges_(k, 3)));
        }
    }

    /// Evaluate the residuals and their derivatives, differences over half a pixel: they average single pixels.
    void linearise() {
        evaluate(pose, true, here_);
        const double distance = pose.c.norm(), half = 0.5 * fields_.factor * distance / ball_.camera.fx;  // m
        const Matrix3d B = ray_basis(pose.c);
        J_.setZero(Eigen::Index(ball_.size), 6), outline_J_.setZero(DIRECTIONS, 6);
        for (int k = 0; k < 6; k++) {
            const double by = k < 2    ? half
                              : k == 2 ? half * std::min(distance / ball_.radius, 40.0)
                                       : 0.5 * half / ball_.radius;
            for (int s = 0; s < 2; s++) {
                Pose at = pose;
                const double signed_by = s == 0 ? by : -by;
                if (k < 3) {
                    at.c += signed_by * B.col(k);
                } else {
                    at.R = exp(signed_by * Vector3d::Unit(k - 3)) * pose.R;
                }
                evaluate(at, k < 3, side_[s]);
            }
            const auto both = side_[0].w.array() > 0.0 && side_[1].w.array() > 0.0;
            J_.col(k) = both.select((side_[0].r - side_[1].r) / (2.0 * by), 0.0);
            if (k < 3) outline_J_.col(k) = (side_[0].outline - side_[1].outline) / (2.0 * by);
        }
    }

    /// Add a residual's row to the normal equations; `slope` is its derivative by the offset number `k`, if k >= 0.
    void add(double weight, const Vector<6>& J, double residual, int k, double slope) {
        A_.topLeftCorner<6, 6>().noalias() += weight * J * J.transpose();
        b_.head<6>() -= weight * residual * J;
        if (k < 0 || slope == 0.0) return;
        const int at = 6 + k;
        A_.block<6, 1>(0, at) += weight * slope * J;
        A_.block<1, 6>(at, 0) += weight * slope * J.transpose();
        A_(at, at) += weight * slope * slope;
        b_[at] -= weight * slope * residual;
    }

    /// Assemble the normal equations, with each row weighted by the probability that it is no outlier.
    void assemble(double width, bool coarse) {
        const int size = 7 + int(colours_), last = int(colours_);
        A_.setZero(size, size), b_.setZero(size);
        for (size_t q = 0; q < ball_.size; q++) {
            const auto i = Eigen::Index(q);
            if (here_.w[i] == 0.0) continue;
            const int k = ball_.colour[q];
            const double p = fields_.fraction[size_t(std::max(k, 0))], r = here_.r[i] / width, e = here_.e[i] / width;
            const double inlier = (1.0 - OUTLIER) * std::exp(-0.5 * r * r) / ((1.0 - p) * std::exp(-0.5 * e * e) + p);
            const double residual = here_.r[i] - (k >= 0 ? here_.g[i] * offsets_[k] : 0.0);
            const double weight = here_.w[i] * inlier / (inlier + OUTLIER) / (fields_.sigma * fields_.sigma);
            add(weight, J_.row(i).transpose(), residual, k, -here_.g[i]);
        }
        const double f = fields_.factor, variance = EDGE_SIGMA * f * EDGE_SIGMA * f;
        for (size_t q = 0; q < DIRECTIONS; q++) {
            if (edges_(q, 4) == 0.0) continue;
            const double r = here_.outline[Eigen::Index(q)];
            const double inlier =
                (1.0 - EDGE_HIDDEN) * std::exp(-0.5 * r * r / variance / (coarse ? 4.0 : 1.0)) / EDGE_UNIFORM;
            const double weight = inlier / (inlier + EDGE_HIDDEN) / variance;
            add(weight, outline_J_.row(Eigen::Index(q)).transpose(), r - offsets_[last], last, -1.0);
        }
        for (int k = 0; k <= last; k++) {
            const double sigma = k < last ? fields_.rim[size_t(k)].sigma : EDGE_OFFSET * f;
            A_(6 + k, 6 + k) += 1.0 / (sigma * sigma);
            b_[6 + k] -= offsets_[k] / (sigma * sigma);
        }
        const double a = ball_.radius, prior[6] = {0.5 * a, 0.5 * a, 2.0 * a, 0.3, 0.3, 0.3};
        for (int k = 0; k < 6; k++) A_(k, k) += 1.0 / (prior[k] * prior[k]);
    }

    /// Move the pose by a step, shortened to half a radius across, 15 % of the distance, and 0.4 rad.
    void step(const Eigen::VectorXd& dx) {
        const double across = std::max(std::abs(dx[0]), std::abs(dx[1])) / (0.5 * ball_.radius);
        const double along = std::abs(dx[2]) / (0.15 * pose.c.norm()),
                     turn = dx.segment<3>(3).cwiseAbs().maxCoeff() / 0.4;
        const double scale = 1.0 / std::max({across, along, turn, 1.0});
        pose.c += scale * ray_basis(pose.c) * dx.head<3>();
        pose.R = exp(scale * dx.segment<3>(3)) * pose.R;
        offsets_ += dx.tail(offsets_.size());
    }

    const BallModel& ball_;
    const FieldsView& fields_;
    const Edges& edges_;
    Sight sight_;
    size_t colours_;
    Eigen::VectorXd offsets_, b_;
    Eigen::MatrixXd A_, J_, outline_J_;
    Residuals here_, side_[2];
};

nb::tuple refine(nb::handle position_, nb::handle rotation_, const BallModel& ball, const FieldsView& fields,
                 nb::handle edges_, int rounds) {
    const auto position = array<const double, 3>(position_, "position");
    const auto R = array<const double, 3, 3>(rotation_, "rotation");
    const auto edges = array<const double, DIRECTIONS, 5>(edges_, "edges");
    fields.require_colours_of(ball);
    if (rounds < 0 || rounds > 100) throw nb::value_error("rounds: must be from 0 to 100");
    auto new_position = zeros<double>({3}), new_rotation = zeros<double>({3, 3}), covariance = zeros<double>({6, 6});
    auto rims = zeros<double>({fields.rim.size()});
    double slope;
    {
        nb::gil_scoped_release release;
        Refinement refinement(ball, fields, edges,
                              {Eigen::Map<const Vector3d>(position.data()), Eigen::Map<const Matrix<3>>(R.data())});
        slope = refinement.run(rounds);
        Eigen::Map<Vector3d>(new_position.data()) = refinement.pose.c;
        Eigen::Map<Matrix<3>>(new_rotation.data()) = refinement.pose.R;
        Eigen::Map<Matrix<6>>(covariance.data()) = refinement.covariance();
        Eigen::Map<Eigen::VectorXd>(rims.data(), Eigen::Index(fields.rim.size())) = refinement.rims();
    }
    return nb::make_tuple(new_position, new_rotation, covariance, slope, rims);
}

}  // namespace

void bind_refine(nb::module_& m) {
    m.def("refine", &refine, arg("position"), arg("rotation"), arg("ball"), arg("fields"), arg("edges"), arg("rounds"));
}

}  // namespace spheremouse::wand
