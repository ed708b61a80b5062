// Assignment of spots to the discs of a ball, by two and by three spots, and the pose of each assignment.
#include <array>
#include <numeric>

#include "spheremouse/wand/kernels.h"

namespace spheremouse::wand {
namespace {

constexpr size_t MAX_NEIGHBOURS = 8;  // of a spot: as many discs as one side of a ball shows

/// Spots in reduced coordinates: place and area, colour.
struct Spot {
    Vector2d xy;
    double area;
    int colour;
};

/// Disc: unit vector of its centre in `ball`, angular radius, colour.
struct Disc {
    Vector3d n;
    double angle;
    int colour;
};

struct Hypothesis {
    double score;
    Vector3d centre;  // radii of the ball, in cam
    Matrix3d R;       // R_cam_ball
};

/// Return the common area of two circles of radii a and b at a distance.
double overlap(double a, double b, double gap) {
    if (gap >= a + b) return 0.0;
    if (gap <= std::abs(a - b)) return PI * std::min(a, b) * std::min(a, b);
    const double u = (gap * gap + a * a - b * b) / (2.0 * gap), v = gap - u;
    return a * a * std::acos(u / a) - u * std::sqrt(a * a - u * u) + b * b * std::acos(v / b) -
           v * std::sqrt(b * b - v * v);
}

/// Return orthonormal columns along a + b, a - b and across both. a and b are unit vectors.
Matrix3d frame(const Vector3d& a, const Vector3d& b) {
    Matrix3d F;
    F.col(0) = (a + b).normalized();
    F.col(1) = (a - b - (a - b).dot(F.col(0)) * F.col(0)).normalized();
    F.col(2) = F.col(0).cross(F.col(1));
    return F;
}

class Search {
  public:
    Search(const Array<const double, 3>& limits, double min_score, size_t max_found)
        : least_scale(limits(0)),
          most_scale(limits(1)),
          tolerance(limits(2)),
          min_score(min_score),
          max_found(max_found) {}

    std::vector<Spot> spots, glare;  // glare: radius in place of area
    std::vector<Disc> discs;
    double least_scale, most_scale;  // of the ball's radius over its distance
    double tolerance;                // of a centroid, reduced coordinates
    double min_score;
    size_t max_found;
    std::vector<Hypothesis> found;

    /// Assign from spot `begin` on. Return the spot at which `max_assignments` were reached, or 0.
    size_t run(size_t begin, int64_t max_assignments) {
        int64_t spent = 0;
        for (size_t at = 0; at < spots.size(); at++) {
            const size_t s0 = (begin + at) % spots.size();
            if (spent >= max_assignments) return s0;
            const std::vector<double> gap = look_at(s0);
            const double reach = 4.0 * most_scale * most_scale;
            for (size_t i1 = 1; i1 < near_.size(); i1++) {
                const size_t s1 = near_[i1];
                if (s1 > s0 && gap[s1] < reach) {
                    spent += number(s0) * number(s1);
                    assign_two(s0, s1);
                }
                for (size_t i2 = i1 + 1; i2 < near_.size(); i2++) {
                    const size_t s2 = near_[i2];
                    if (gap[s2] > reach || (s1 < s0 && s2 < s0)) continue;
                    spent += number(s0) * number(s1) * number(s2);
                    assign_three(s0, s1, s2);
                }
            }
        }
        return 0;
    }

  private:
    /// Project all spots to the plane that touches the unit sphere at a spot's ray: nearby, perspective has no effect.
    std::vector<double> look_at(size_t s0) {
        const Vector3d ray = spots[s0].xy.homogeneous();
        axes_.col(0) = Vector3d(1.0, 0.0, -ray[0]) / std::sqrt(1.0 + ray[0] * ray[0]);
        axes_.col(2) = ray / ray.norm();
        axes_.col(1) = axes_.col(2).cross(axes_.col(0));
        q_.clear(), glare_q_.clear();
        std::vector<double> gap;
        for (const Spot& s : spots) {
            const Vector3d p = axes_.transpose() * s.xy.homogeneous();
            q_.push_back(p.head<2>() / p[2]);
            gap.push_back(p[2] > 0.0 ? q_.back().squaredNorm() : 1e9);
        }
        for (const Spot& s : glare) {
            const Vector3d p = axes_.transpose() * s.xy.homogeneous();
            glare_q_.emplace_back(p[0] / p[2], p[1] / p[2], p[2] > 0.0 ? s.area : 0.0);
        }
        near_.resize(spots.size());
        std::iota(near_.begin(), near_.end(), 0);
        std::stable_sort(near_.begin(), near_.end(), [&](size_t a, size_t b) { return gap[a] < gap[b]; });
        near_.resize(std::min(spots.size(), MAX_NEIGHBOURS + 1));
        return gap;
    }

    int64_t number(size_t spot) const {
        return std::count_if(discs.begin(), discs.end(), [&](const Disc& d) { return d.colour == spots[spot].colour; });
    }

    /// Assign three spots to triples of discs: scaled orthographic projection, two solutions.
    void assign_three(size_t s0, size_t s1, size_t s2) {
        Eigen::Matrix2d D;
        D << q_[s1] - q_[s0], q_[s2] - q_[s0];
        const Spot* spot[3] = {&spots[s0], &spots[s1], &spots[s2]};
        for (const Disc& a : discs) {
            if (a.colour != spot[0]->colour) continue;
            for (const Disc& b : discs) {
                if (&b == &a || b.colour != spot[1]->colour || a.n.dot(b.n) < -0.9) continue;
                for (const Disc& c : discs) {
                    if (&c == &a || &c == &b || c.colour != spot[2]->colour || a.n.dot(c.n) < -0.9 ||
                        b.n.dot(c.n) < -0.9)
                        continue;
                    solve(D, spot, {&a, &b, &c}, q_[s0]);
                }
            }
        }
    }

    /// Solve M (n_b - n_a, n_c - n_a) = D for the first two rows M of the rotation times the scale.
    void solve(const Eigen::Matrix2d& D, const Spot* const* spot, const std::array<const Disc*, 3>& disc,
               const Vector2d& q) {
        Eigen::Matrix<double, 3, 2> B;
        B << disc[1]->n - disc[0]->n, disc[2]->n - disc[0]->n;
        const Eigen::Matrix2d G = B.transpose() * B;
        if (G.determinant() < 1e-3) return;
        const Eigen::Matrix2d P = D * G.inverse(), A = P * D.transpose();
        const double half = 0.5 * A.trace(), d = A(0, 0) - A(1, 1), root = std::sqrt(0.25 * d * d + A(0, 1) * A(0, 1));
        const double scale = std::sqrt(half + root);
        if (!(least_scale < scale && scale < most_scale)) return;
        for (int i = 0; i < 3; i++) {  // no spot is larger than its disc
            const double radius = scale * disc[size_t(i)]->angle;
            if (spot[i]->area > 1.6 * PI * radius * radius + 9.0 * tolerance * tolerance) return;
        }
        // part of both rows along the triangle's normal: eigenvector of the smaller eigenvalue
        Vector2d e(A(0, 1), half - root - A(0, 0));
        if (e.lpNorm<1>() < 1e-12 * half) e = A(0, 0) < A(1, 1) ? Vector2d(1.0, 0.0) : Vector2d(0.0, 1.0);
        e = e.normalized() * std::sqrt(2.0 * root);
        const Vector3d normal = B.col(0).cross(B.col(1)).normalized();
        for (const double sign : {1.0, -1.0}) {
            Matrix3d R;
            R.topRows<2>() = (P * B.transpose() + sign * e * normal.transpose()) / scale;
            R.row(2) = R.row(0).cross(R.row(1));
            bool facing = true;
            for (const Disc* each : disc) facing = facing && R.row(2).dot(each->n) < -0.05;
            if (facing) keep(q - scale * (R * disc[0]->n).head<2>(), scale, R);
        }
    }

    /// Assign two spots to pairs of discs. The area of a spot gives the angle by which its disc is turned away.
    void assign_two(size_t s0, size_t s1) {
        const Vector2d d = q_[s1] - q_[s0];
        const double gap = d.squaredNorm();
        for (const Disc& a : discs) {
            for (const Disc& b : discs) {
                if (&a == &b || a.colour != spots[s0].colour || b.colour != spots[s1].colour || a.n.dot(b.n) < -0.9)
                    continue;
                const double chord = 2.0 - 2.0 * a.n.dot(b.n);
                const double area_a = spots[s0].area / (PI * a.angle * a.angle),
                             area_b = spots[s1].area / (PI * b.angle * b.angle);
                const double other = area_a - area_b;
                const double square = (gap + std::sqrt(gap * gap + 4.0 * chord * other * other)) / (2.0 * chord),
                             scale = std::sqrt(square);
                if (!(least_scale < scale && scale < most_scale)) continue;
                if (area_a / square > 1.25 || area_b / square > 1.25)
                    continue;  // larger than discs seen from the front
                const double za = std::min(area_a / square, 0.999), zb = std::min(area_b / square, 0.999);
                // in units of the radius: x of a with |a| = 1, |a + d| = 1
                const double length = std::sqrt(gap) / scale;
                const Vector2d u = d / (length * scale), across(-u[1], u[0]);
                const double along = ((1.0 - zb * zb) - (1.0 - za * za) - length * length) / (2.0 * length);
                const double aside = std::sqrt(std::max(1.0 - za * za - along * along, 0.0));
                for (const double sign : {1.0, -1.0}) {
                    const Vector2d at = along * u + sign * aside * across, to = at + length * u;
                    const Matrix3d R = frame({at[0], at[1], -za}, {to[0], to[1], -zb}) * frame(a.n, b.n).transpose();
                    keep(q_[s0] - scale * at, scale, R);
                }
            }
        }
    }

    /// Keep a pose of sufficient score, in place of the worst one if there are many.
    void keep(const Vector2d& centre, double scale, const Matrix3d& R) {
        const auto [share, count] = score(centre, scale, R);
        if (share < min_score) return;
        const double value = share * count;  // two discs can agree by chance, five cannot
        Hypothesis hypothesis{value, axes_ * centre.homogeneous() / scale, axes_ * R};
        if (found.size() < max_found) {
            found.push_back(hypothesis);
            return;
        }
        const auto worst = std::min_element(found.begin(), found.end(),
                                            [](const auto& a, const auto& b) { return a.score < b.score; });
        if (worst->score < value) *worst = hypothesis;
    }

    /// Return the fraction, by area, of the visible discs with a spot of their colour and size, and their number.
    /// A spot on the ball without a disc reduces the fraction. The part of a disc that glare hides does not.
    std::pair<double, int> score(const Vector2d& centre, double scale, const Matrix3d& R) const {
        double found_area = 0.0, expected_area = 0.0;
        int count = 0;
        unsigned used = 0;  // bits of the spots that belong to a disc
        const double within = (0.15 * scale + tolerance) * (0.15 * scale + tolerance);
        for (const Disc& d : discs) {
            const Vector3d n = R * d.n;
            const double z = -n[2], inside = scale * d.angle * scale * d.angle, expected = PI * inside * z;
            if (z < 0.0) continue;
            const Vector2d at = centre + scale * n.head<2>();
            double shown = expected;
            for (const Vector3d& g : glare_q_)
                shown -= overlap(std::sqrt(expected / PI), g[2], (g.head<2>() - at).norm());
            shown = std::max(shown, 0.0);
            if (z > 0.25) expected_area += shown;
            // a highlight or a finger leaves part of a disc, with a centroid anywhere inside its outline
            const Vector2d u = (at - centre) / std::max((at - centre).norm(), 1e-9);
            for (size_t i = 0; i < near_.size(); i++) {
                const Spot& s = spots[near_[i]];
                if (s.colour != d.colour) continue;
                const Vector2d by = q_[near_[i]] - at;
                const double across = by.dot(u) / std::max(z, 0.25), aside = by[1] * u[0] - by[0] * u[1];
                const bool part = s.area < expected && across * across + aside * aside < inside;
                if (!part && by.squaredNorm() >= within) continue;
                used |= 1u << i;
                if (z > 0.25) {
                    // the reach of glare is inexact: any area from the rest to the whole disc agrees
                    found_area += shown * std::min({s.area / std::max(shown, 1e-12), expected / s.area, 1.0});
                    count++;
                }
                break;
            }
        }
        for (size_t i = 0; i < near_.size(); i++)
            if (!(used & 1u << i) && (q_[near_[i]] - centre).squaredNorm() < 0.81 * scale * scale)
                expected_area += spots[near_[i]].area;
        return {expected_area > 0.0 ? found_area / expected_area : 0.0, count};
    }

    Matrix3d axes_;                  // of the plane, columns in cam
    std::vector<Vector2d> q_;        // of the spots, in the plane
    std::vector<Vector3d> glare_q_;  // place and radius in the plane
    std::vector<size_t> near_;       // spots by their distance from the first
};

nb::tuple assign_spots(nb::handle spots_, nb::handle discs_, nb::handle glare_, nb::handle limits_, double min_score,
                       size_t first_spot, int64_t max_assignments, size_t max_found) {
    const auto spots = array<const double, -1, 4>(spots_, "spots");
    const auto discs = array<const double, -1, 5>(discs_, "discs");
    const auto glare = array<const double, -1, 3>(glare_, "glare");
    const auto limits = array<const double, 3>(limits_, "limits");
    if (max_found == 0) throw nb::value_error("max_found: must be positive");
    Search search(limits, min_score, max_found);
    for (size_t i = 0; i < spots.shape(0); i++)
        search.spots.push_back({{spots(i, 0), spots(i, 1)}, spots(i, 2), int(spots(i, 3))});
    for (size_t i = 0; i < glare.shape(0); i++) search.glare.push_back({{glare(i, 0), glare(i, 1)}, glare(i, 2), 0});
    for (size_t i = 0; i < discs.shape(0); i++)
        search.discs.push_back({Eigen::Map<const Vector3d>(&discs(i, 0)), discs(i, 3), int(discs(i, 4))});
    size_t next;
    {
        nb::gil_scoped_release release;
        next = search.run(first_spot, max_assignments);
    }
    const size_t n = search.found.size();
    auto score = zeros<double>({n}), position = zeros<double>({n, 3}), rotation = zeros<double>({n, 3, 3});
    for (size_t i = 0; i < n; i++) {
        score.data()[i] = search.found[i].score;
        Eigen::Map<Vector3d>(position.data() + 3 * i) = search.found[i].centre;
        Eigen::Map<Matrix<3>>(rotation.data() + 9 * i) = search.found[i].R;
    }
    return nb::make_tuple(score, position, rotation, next);
}

}  // namespace

void bind_assign(nb::module_& m) {
    m.def("assign_spots", &assign_spots, arg("spots"), arg("discs"), arg("glare"), arg("limits"), arg("min_score"),
          arg("first_spot"), arg("max_assignments"), arg("max_found"));
}

}  // namespace spheremouse::wand
