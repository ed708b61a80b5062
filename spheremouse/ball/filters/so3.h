// The state and the points of the default filter, and the parts of its update, as its sources share them.
#pragma once

#include "spheremouse/ball/filters/so3_steps.h"
#include "spheremouse/geometry/rotation.h"

namespace spheremouse::ball {

constexpr double LINEAR = 0.02;  // rad: a correction larger than that is made again about where it led

using Dense = Matrix<Dynamic>;
using Indices = std::vector<int>;
using Noise = Matrix<CORE>;    // process noise that the covariance does not include yet
using Each = Vector<Dynamic>;  // a value for each disc

/// The ball as the filter predicts it: `So3State.body`.
struct Body {
    Matrix<3> attitude;
    Vector<3> rate, acceleration;
    View<Dynamic, 3> discs;
    View<Dynamic, 6> basis;  // rows of (3, 2)
    View<> P;
    double readout;       // s, by which the rolling shutter takes longer than the rig says
    Vector<RIG_DIM> rig;  // relative error of the focal length, and the point that the ball turns about, m, obj
    Vector<3> eccentricity;  // from that point to the ball's centre, m, ball
    int known;            // discs; the others are candidates, which no point corrects
    bool holds;           // `rig` as it is
    int others;           // cameras that do not show this frame

    int size() const { return int(discs.rows()); }

    /// The rows of P with the errors of the readout and of the first disc.
    int readout_row() const { return READOUT + VIEW * others; }
    int map_row() const { return readout_row() + 1; }

    /// The rig that the frame shows: its centre is that of the ball.
    Vector<RIG_DIM> seen_rig() const {
        Vector<RIG_DIM> seen = rig;
        seen.tail<3>() += attitude * eccentricity;
        return seen;
    }

    /// The turn from the stamp to `delay`, s, after it.
    Vector<3> turn(double delay) const { return rate * delay + 0.5 * acceleration * delay * delay; }
};

/// Points of a frame: `SpherePoints.measurement`.
struct Points {
    Matrix<Dynamic, 3> direction;
    View<Dynamic, 9> covariance;  // m², of image noise
    Each delay;                   // s, with the estimated readout
    Eigen::Map<const Each> row;
    View<Dynamic, 3 * RIG_DIM> ddirection_drig;
    double radius;        // m
    Vector<RIG_DIM> rig;  // estimated errors of the rig that the directions include

    int size() const { return int(direction.rows()); }

    /// Effect of errors of the rig on the direction, rad and rad/m.
    View<3, RIG_DIM> by_rig(int i) const { return View<3, RIG_DIM>(ddirection_drig.row(i).data()); }

    /// Image noise of the direction, rad².
    Matrix<3> noise(int i) const { return View<3, 3>(covariance.row(i).data()) / (radius * radius); }
};

/// A disc as the camera sees it.
struct Place {
    Vector<3> p;     // obj
    Matrix<3, 2> E;  // tangent axes, obj
    Matrix<2, 3> H;  // d z / d rotation error of z = E' b: a turn e moves p by e x p

    /// A disc and its axes in ball, at an attitude.
    Place(const Vector<3>& disc, const Matrix<3, 2>& basis, const Matrix<3>& attitude)
        : p(attitude * disc), E(attitude * basis) {
        for (int a = 0; a < 2; a++) H.row(a) = p.cross(Vector<3>(E.col(a))).transpose();
    }

    /// The disc k some time after the stamp.
    Place(const Body& body, int k, double delay);
};

constexpr int FIXED = MAP_OFFSET;  // errors on which the place of a disc depends, besides its own

/// Return d z / d (rotation, rate, acceleration, eccentricity, rig, axes, readout) of the point i.
Matrix<2, FIXED> jacobian(const Body& body, const Points& points, int i, const Place& place);

/// Return the columns of A, (m, n), of the errors in the order of the Jacobian.
Matrix<Dynamic, FIXED> fixed_columns(const Dense& A, const Body& body);

/// The innovations of k pairs.
struct Innovation {
    Matrix<Dynamic, CORE> H;  // (2k, 9)
    Dense HP;                 // (2k, n)
    Each z;                   // (2k,)
    Dense S;                  // covariance of z
};

/// Pairs of points, `rows`, with discs, `columns`.
struct Pairs {
    Indices rows, columns;
    int possible = 0;    // greatest number of pairs
    bool plain = false;  // no other pair was possible
    bool in_place = false, agree = false;
    double noise_scale = 1.0;  // of the level at which they pair
    double widest = 0.0;       // rad², largest of a place given the other pairs: root of the covariance's determinant
    Innovation innovation = {};

    /// All that could pair does, each in its place.
    bool complete() const { return in_place && int(rows.size()) == possible; }
};

/// The state after a correction.
struct Corrected {
    Dense P;
    Each dx;
    Posterior steps;
    double log_likelihood, nis;
    int pairs;
};

/// A state moved by an error vector, with the fields of `Body`.
struct Moved {
    Matrix<3> attitude;
    Vector<3> rate, acceleration;
    Matrix<Dynamic, 3> discs;
    Matrix<Dynamic, 6> basis;
    Dense P;  // of the errors about the moved state
    double readout;
    Vector<RIG_DIM> rig;
    Vector<3> eccentricity;
    int known;
    bool holds;
    int others;

    Body body() const;
};

/// The motion since the last frame that no correction has used: `So3State.pending`.
struct Pending {
    Noise process;  // of the prediction at the first level
    double interval;
    Each weights;  // probability of each level
    Modes modes;

    /// The process noise of a level that the prediction has not added.
    Noise added(double noise_scale) const { return (noise_scale - 1.0) * process; }
};

/// Settings of the filter: `so3_settings.ActivityModel`.
struct Activity {
    double gate, persistence, dwell;
    Each variances, drift, usual;

    /// The variances of the levels over that of the first.
    Each squares() const { return variances / variances(0); }
};

/// A camera that sees directions with a cosine to `towards`, obj, above the horizon.
struct Viewer {
    Vector<3> towards;
    double horizon;
    Matrix<3> covariance;  // rad², of the attitude
};

Body read_body(nb::tuple body);

/// Read the points as measured.
Points read_points(nb::tuple points);

/// Read the points as seen with the rig and the readout of `body`.
Points read_points(nb::tuple points, const Body& body);

/// Read indices, (k,), below `size`. Raise an IndexError that names them.
Indices read_indices(nb::handle given, const char* name, int size);
Pairs read_pairs(nb::handle rows, nb::handle columns, const Body& body, const Points& points);

/// Read `towards` and `horizon` of a camera.
Viewer read_camera(nb::tuple camera);

/// Return the variance, rad², of the predicted place of the disc k, on the worse axis.
double place_variance(const Body& body, int k, const Noise& added);

/// Return the discs that the camera sees.
Indices visible(const Body& body, const Viewer& viewer);

/// Return squared distances, (n, k), of points to the discs `which`, exact below `gate`.
///
/// Errors of the considered parameters alone reject no disc. Most pairs are one without them.
Dense distances(const Body& body, const Points& points, const Indices& which, const Noise& added, double allowance,
                double gate);

/// Return the pairs at the expected level.
Pairs expected_pairs(const Body& body, const Points& points, const Viewer& viewer, const Pending& pending,
                     const Activity& activity);

/// Return the pairs at the most likely level at which most points pair, from those at the `expected` one.
Pairs likeliest_pairs(Pairs expected, const Body& body, const Points& points, const Viewer& viewer,
                      const Pending& pending, const Activity& activity);

/// Return `rows`, `columns`, whether they are complete, and `noise_scale`.
nb::tuple pairs_to_numpy(const Pairs& pairs);

/// Return the innovations of pairs. The noise `added` counts for the terms that the linear model omits.
Innovation innovation(const Body& body, const Points& points, const Pairs& pairs, const Noise& added);

/// Read `So3State.pending`. A state without modes has one, with the moments of `body`.
Pending read_pending(nb::tuple pending, const Body& body, const Activity& activity);
Activity read_activity(nb::tuple activity);

/// Correct a state by the innovations of pairs.
std::pair<Corrected, Moved> correct_by_pairs(const Body& body, const Points& points, const Pairs& pairs,
                                             const Pending& pending, const Activity& activity);

/// Return the fields of `So3State`: those from `attitude` to `basis`, `joint`, `weights`, those from `manoeuvre_level`
/// to `readout`, and `modes`.
nb::tuple corrected_to_numpy(const Moved& moved, const Corrected& corrected);

/// Move a state by errors, whose covariance before the move is P.
///
/// If given, an `error` of the state becomes the same error of the moved state.
Moved move(const Body& body, const Each& dx, Dense P, Each* error = nullptr);

nb::tuple moved_to_numpy(const Moved& moved);

}  // namespace spheremouse::ball
