"""Changes of the default filter's state by all but discs: errors of camera, rig and axes, and the ball's place."""

import numpy as np

from spheremouse.ball.filters.so3_motion import CAMERA_DIM, KINEMATIC_DIM, READOUT, RIG_DIM, RIG_ROW
from spheremouse.ball.filters.so3_state import CENTRE, COMMON, ECCENTRICITY, RIG, So3State, omitted_variance
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels

_FALSE_TURN_S = 0.1  # s, in which a camera moves before its targets show it


def with_rig_uncertainty(state: So3State, covariance: Array) -> So3State:
    """Return the state with a further `covariance`, (4, 4), of focal length and centre. Its estimates stay.

    The conditional distribution of all other errors given those of the rig stays. So discs that were found with the
    wrong rig have its errors in common.
    """
    P, first = state.joint, state.map_row
    S = np.linalg.lstsq(P[RIG, RIG], P[RIG])[0].T
    S[RIG] = np.eye(RIG_DIM)
    joint = P + S @ covariance @ S.T
    places = S[first : first + 2 * len(state.landmarks)].reshape(-1, 2, RIG_DIM)
    rows = np.arange(first, first + 2 * len(places))
    joint[rows, rows] += np.repeat(omitted_variance(places @ covariance @ places.transpose(0, 2, 1)), 2)
    return state._replace(joint=joint)


def with_seen_centre(
    state: So3State, place: Array, axes: Array, covariance: Array, since: Array | None = None
) -> So3State:
    """Return a predicted state corrected by the centre's `place`, (k,) m, along `axes`, (3, k), with its covariance.

    The place is from that in the rig, or from that of a ball in the rig at the attitude `since`, (3, 3).
    Rate and acceleration keep their values, since the pending modes describe them.
    """
    P, turned = state.joint, state.attitude if since is None else state.attitude - since
    C = P[:, CENTRE] @ axes + P[:, ECCENTRICITY] @ turned.T @ axes
    S = axes.T @ (C[CENTRE] + turned @ C[ECCENTRICITY]) + covariance
    K = np.linalg.solve(S, C.T).T
    K[3:KINEMATIC_DIM] = 0.0
    reduced = K @ C.T
    joint = P - reduced - reduced.T + K @ S @ K.T
    motion, joint, readout, rig_error, eccentricity = kernels.move(
        (*state.body[:5], joint, *state.body[6:]), K @ (place - axes.T @ (state.pivot + turned @ state.eccentricity))
    )
    attitude, _, _, landmarks, basis = motion
    fields = {"attitude": attitude, "landmarks": landmarks, "basis": basis, "joint": joint}
    return state._replace(**fields, readout=readout, rig_error=rig_error, eccentricity=eccentricity)


def with_uncertain_turn(state: So3State, turn: Array) -> So3State:
    """Return the state with more covariance: any part of `turn`, (3,) rad, in obj, may be the camera's.

    It was seen within about `_FALSE_TURN_S`, so the rate may be wrong by turn / T, the acceleration by turn / T². Means
    stay.
    """
    added_covariances = [np.outer(turn, turn) / _FALSE_TURN_S ** (2 * k) for k in range(3)]
    joint = state.joint.copy()
    for k, added in enumerate(added_covariances):
        joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += added
    if state.modes is None:
        return state._replace(joint=joint)
    means, covariances, weights = state.modes
    covariances = covariances.copy()
    covariances[:, :3, :3] += added_covariances[1]
    covariances[:, 3:, 3:] += added_covariances[2]
    return state._replace(joint=joint, modes=(means, covariances, weights))


def move_centres(joint: Array, covariance: Array, others: int) -> None:
    """Add the covariance, (3, 3), of a motion of the ball that all cameras see to `joint` in place."""
    centres = [slice(at + 1, at + 4) for at in (RIG_ROW, *(READOUT + CAMERA_DIM * k for k in range(others)))]
    for one in centres:
        for other in centres:
            joint[one, other] += covariance


def add_common(joint: Array, covariance: Array) -> None:
    """Add the covariance, (7, 7), of independent errors of rig and axes to `joint` in place."""
    joint[COMMON, COMMON] += covariance


def forget_common(joint: Array) -> None:
    """Remove the errors of rig and axes from `joint` in place."""
    joint[COMMON] = 0.0
    joint[:, COMMON] = 0.0
