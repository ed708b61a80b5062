// Steps of the acceleration between frames, and their posterior from the innovations.
//
// A hand takes hold of the ball, pushes it, lets it go and stops it. The acceleration jumps at each of these events and
// is nearly constant between them. The events are a Poisson process (compound Poisson jumps). At each event the hand
// changes its push, lets go or stops the ball. The new acceleration is then about the last one, about zero, or about
// one that brings the ball to rest. Its level is that of the last step, or the level above or below it.
//
// The instant of a step between two frames, its level and its size are unknown. Each pair (instant, level) is a
// hypothesis, and its likelihood is its weight. A step shows in the discs only after some time. So the hypotheses stay
// apart as the modes of the state: no recent step, or a step at one of the levels. The next frame weighs each mode
// together with each hypothesis about the new interval. Then all with the same new level become one mode (generalised
// pseudo-Bayesian of order 2: Bar-Shalom, Li, Kirubarajan 2001, section 11.6.5). A step is recent for 1/30 s on the
// average, at any frame rate.
#pragma once

#include "spheremouse/native/matrices.h"

namespace spheremouse::ball {

// The order of the errors, `so3_motion.py`.
constexpr int CORE = 9;                  // rotation, rate, acceleration
constexpr int ECCENTRICITY = CORE;       // of the ball's centre from the point that it turns about, in ball
constexpr int RIG = ECCENTRICITY + 3;    // of the rig, which the filter may estimate: focal length, that point
constexpr int RIG_DIM = 4;               // the same, number
constexpr int AXES = RIG + RIG_DIM;      // of obj
constexpr int READOUT = AXES + 3;        // of one camera; the errors of others lie before it
constexpr int MAP_OFFSET = READOUT + 1;  // the same
constexpr int VIEW = 8;                  // errors of another camera: rig, axes, readout
constexpr int CLONE = 3;                 // at the end

constexpr int INSTANTS = 6;  // of a step in an interval

/// The errors of rate and acceleration, less those that all modes share, for each level of a recent step.
struct Modes {
    std::vector<Vector<6>> means;
    std::vector<Matrix<6>> covariances;
    Matrix<Dynamic> weights;  // (modes, levels) joint probability of each mode and level
};

/// Read the modes that Python holds as arrays of means, (j, 6), covariances, (j, 6, 6), and weights, (j, l).
Modes read_modes(nb::tuple arrays);

nb::tuple modes_to_numpy(const Modes& modes);

/// Possible steps in the interval since the last frame.
struct Steps {
    double interval;            // s
    double between;             // s, mean time between two events
    Vector<Dynamic> variances;  // (rad/s²)² per axis of each level; the first is a ball left to roll, without steps
    Vector<Dynamic> usual;      // probability of each level in the long run
};

/// The errors after the correction, of rate and acceleration, as a linear function of x and d.
struct Effect {
    Matrix<6> root;    // rate and acceleration before the step are root x, and what all modes share
    Matrix<6, 15> T;   // of x and d
    Matrix<6> shared;  // covariance of what all modes share
};

struct Posterior {
    Vector<15> mean;        // of x and d
    Matrix<15> covariance;  // of x and d
    Matrix<15> within;      // its mean over the hypotheses
    Modes modes;            // of the next frame, relative to the new mean
    double level;           // rms of the steps, relative to the first level; 1 without a step
    double log_ratio;       // log likelihood ratio of z to no error
    double excess;          // mean normalised square of z, less z' R^-1 z
};

/// Return the posterior of the errors x of the predicted motion and of the effect d, (9,), of a step.
///
/// A step adds d to rotation, rate and acceleration. `gram` is G' R^-1 G. The columns of G are those of x, d, and the
/// innovations z, whose covariance is R if x and d are known. `motion` is the predicted rate, rad/s, and acceleration.
Posterior posterior(const Matrix<16>& gram, const Effect& effect, const Vector<6>& motion, const Steps& steps,
                    const Modes& modes);

}  // namespace spheremouse::ball
