"""A wrong type, shape or order of an array raises TypeError with the argument's name."""

import numpy as np
from numpy.typing import NDArray

_Float = NDArray[np.float64]
_Index = NDArray[np.int64]
_Byte = NDArray[np.uint8]

# spheremouse/geometry/rotation.cpp, the functions of rotation.py for one axis of n

def exp(v: _Float) -> _Float:
    """Return the rotation matrices, (n, 3, 3), of rotation vectors, (n, 3) rad."""

def log(R: _Float) -> _Float:
    """Return the rotation vectors, (n, 3) rad, of rotation matrices, (n, 3, 3)."""

def left_jacobian(v: _Float) -> _Float:
    """Return Jl with exp(v + dv) = exp(Jl dv) exp(v) to first order, (n, 3, 3), of rotation vectors, (n, 3) rad."""

# spheremouse/geometry/camera.cpp, the functions of camera.py

def distort(xy: _Float, distortion: _Float) -> tuple[_Float, _Float]:
    """Distort ideal reduced coordinates, (n, 2); also return the Jacobian, (n, 2, 2)."""

def unproject(
    uv: _Float, intrinsic: tuple[float, float, float, float], distortion: _Float, fold_r2: float
) -> tuple[_Float, _Float]:
    """Convert pixels, (n, 2), to ideal reduced coordinates, (n, 2); also return dxy_duv, (n, 2, 2)."""

# spheremouse/geometry/matching.cpp

def match(worth: _Float) -> _Index:
    """Return for each row of `worth`, (n, m), its column in the one-to-one pairs of greatest total worth, or -1.

    An unpaired row is worth 0. If the best columns of all rows differ, they are the solution.
    """

def mutual_nearest(distance: _Float) -> _Index:
    """Return for each row of a distance matrix, (n, m), the column if each is the other's nearest, else -1.

    The distance `inf` is no pair.
    """

def suppress(points: _Float, radius: _Float, norm: float = 2.0) -> _Index:
    """Return the indices of points, (n, d), that no earlier kept point has within its radius, of (n,).

    Non-maximum suppression (Neubeck, Van Gool 2006) of points in the order of their worth. The norm is 2 or inf.
    """

# spheremouse/ball/constellation/hypotheses.cpp

class Hypotheses:
    """Rotations that map two known directions to a pair of seen ones (Mortari et al. 2004).

    `seen` (n, 3) and `known` (m, 3) are unit vectors. The pairs are those within each of `groups` groups of distant
    seen directions. The angles of the two pairs may differ by `tolerance` rad. There are at most `max_count` rotations.
    """

    rotations: _Float  # (h, 3, 3)
    origins: _Index  # (h, 4) indices of the seen and of the known pair

    def __init__(self, seen: _Float, known: _Float, groups: int, tolerance: float, max_count: int) -> None: ...
    def best(self, sigma: float, gain: float, margin: float, max_count: int) -> _Float:
        """Return the rotations with the best scores, (k, 3, 3), best first, one within 3 sigma.

        A direction near a known one scores `gain` nats minus half its squared distance in standard deviations. These
        are `sigma` rad, and more by the error of the rotation. The result has at most `max_count` rotations, none worse
        than the best one by more than `margin` nats.
        """

    def most_common(self, min_cosine: float) -> tuple[_Float, int]:
        """Return the rotation, (3, 3), with the most matches at a cosine above `min_cosine`, and their number.

        The number is that of matched `seen` or of matched `known`, whichever is smaller. Among equal numbers the
        smallest rotation wins. Without hypotheses the result is the identity and 0.
        """

# spheremouse/ball/texture/align.cpp and learn.cpp. A picture has the contrast of each cell, (6, n, n), and its weight.
# The samples are contrast (k,), direction (3, k) obj, log odds to turn with the ball (k,), and contrast of light that
# stands still (k,).

_Narrow = NDArray[np.float32]
_Samples = tuple[_Narrow, _Narrow, _Narrow, _Narrow]
_Picture = tuple[_Narrow, _Narrow]

def align_texture(
    samples: _Samples, picture: _Picture, R: _Float, noise: float, place: float, pixel: float,
    anchor_of: _Index, across: _Float,
) -> tuple[_Float, float, float, int, bool, _Float, _Float, _Float, _Float, float]:  # fmt: skip
    """Return the fields of `Alignment` near an attitude R, (3, 3).

    A residual has the variance of `noise` and of contours displaced by `place` rad. A pixel shows `pixel` rad of the
    ball. `anchor_of`, (6, n / 8, n / 8), is the anchor of each tile, and `across`, (k, 3, 3), the mean projection
    across the tiles of each anchor.
    """

def shift_of_texture(
    samples: _Samples, picture: _Picture, R: _Float, noise: float, place: float, pixel: float,
    camera: _Float, axes: _Float,
) -> tuple[_Float, _Float]:  # fmt: skip
    """Return the shift of the ball's centre along `axes`, (2, 3) obj, and its covariance, radii, near an attitude R.

    The camera is at `camera`, (3,) radii from the ball's place in obj. The other arguments are those of
    `align_texture`. A shift that no pixel shows is 0, with a huge covariance.
    """

def correlate_texture(samples: _Samples, picture: _Picture, attitudes: _Float, most: int) -> _Float:
    """Return the correlation, (k,), of picture and the `most` strongest samples at attitudes, (k, 3, 3)."""

TILE: int
LEAST_WEIGHT: float
STATIC_ODDS: float
FACING: float  # cosine between ray and normal from which a place is learnt

def learn_texture(
    seen: tuple[_Narrow, NDArray[np.int32], _Narrow, _Narrow, int], picture: tuple[_Narrow, _Narrow, _Narrow],
    tiles: _Index, chart: tuple[_Float, float, int, float], R: _Float, most: float, forget: bool,
) -> None:  # fmt: skip
    """Learn some `tiles`, (j,), of a frame at R, (3, 3), in place.

    `picture` also has the mean weight of each tile, (6, n / 8, n / 8).
    `seen` has the contrast on the chart, (h, w), the number of the sample at every few pixels or -1, (r, c), log odds
    and contrast of light of the samples, and their distance in px. `chart` has the members of `Chart`. A cell is the
    mean of up to `most` views. With `forget` the cells are forgotten that show what stands still.
    """

def leave_out_doubtful(
    samples: _Samples, first: _Narrow, own: _Narrow, change: float, detail: float
) -> tuple[_Narrow, _Narrow]:
    """Return the log odds of the samples, (k,), once -inf for a detail and once for any that may stand still.

    Such a sample differs by less than `change` from the `first` frame, and has log odds of its `own`, (k,), below 3.
    A detail has a contrast above `detail`.
    """

def weigh_static(
    samples: _Samples, picture: _Picture, R: _Float, after: tuple[_Narrow, _Narrow, _Narrow], noise: float,
    share: float, settle: float, apart: float,
) -> None:  # fmt: skip
    """Update three arrays of the samples, (k,), in place.

    `after` has the mean contrast, which takes a `share` of the frame, the log odds that the sample turns with the ball,
    and the contrast that stands still, which takes the share `settle` of what remains. A sample tells only if the
    two explanations are `apart` standard deviations.
    """

# spheremouse/ball/texture/anchors.cpp
def anchor_points(
    anchors: _Float, R: _Float, information: _Float, gradient: _Float,
    errors: tuple[float, float, float, float], known: _Float, facing: tuple[_Float, float], view: tuple[object, ...],
) -> tuple[_Float, _Float, _Index]:  # fmt: skip
    """Return places, (n, 2) px, covariances, (n, 2, 2) px², and indices, (n,), of the anchors that a frame shows.

    They are those of `anchors`, (k, 3) ball, at the attitude R, (3, 3), with the information, (k, 3, 3), and the
    gradient, (k, 3), of the pixels around each. `errors`, rad, are the largest standard deviation of a place, that of
    a place relative to the whole, that of errors that the pixels share, and that of the whole by motion about axes that
    no pixel shows. `known`, (3, 3), projects to the other axes. `facing` has the camera's direction, (3,), and the
    least cosine with it.
    """

# spheremouse/ball/texture/chart.cpp
PARTS: int  # of a pixel

def resample_chart(image: _Byte, at: NDArray[np.int32], part: NDArray[np.uint16], inside: _Byte) -> _Byte:
    """Return grey values of an image between four pixels each, and 0 where `inside` is not 255.

    `at` is the index of the first of the four. `part` counts parts of the way, `PARTS` times those to the next row and
    those to the next column.
    """

def contrast_on_chart(light: _Byte, inside: _Byte, far: _Narrow, reach: int) -> _Narrow:
    """Return the contrast in each row, from its first pixel `inside` to its last one, else 0.

    That is `light` less the mean of means over squares that reach 1 or 2 px from the middle, over `far`, which is that
    of a chart with fewer pixels.
    """

def contrast_of_samples(light: _Byte, at: NDArray[np.int32], far: _Narrow, reach: int) -> _Narrow:
    """Return the contrast of the pixels `at`, (k,) row by row, as `contrast_on_chart` has it."""

# spheremouse/ball/constellation/evidence.cpp

class ObservationModel:
    """Observation model of a ball at a known attitude.

    `view_axis` (3,) is a unit vector from the ball to the camera. A disc at the cosine `half_cosine` with it is seen
    half as often as one in the middle, and `limb_width` is the cosine over which that changes. A disc in the middle is
    seen with `detection_probability`, and is not seen with one of the equally likely `miss_probabilities`, (a,). The
    ratios of the true standard deviation to the given one, `sigma_scales`, (b,), are equally likely too. The number of
    false directions is geometric with the mean `false_mean`, and they are uniform over `area` sr.

    Directions are those of `Hypotheses`, and `variance` (n,) rad² is that of each seen one per axis.
    """

    def __init__(
        self, view_axis: _Float, half_cosine: float, limb_width: float, detection_probability: float,
        miss_probabilities: _Float, sigma_scales: _Float, false_mean: float, area: float,
    ) -> None: ...  # fmt: skip
    def max_log_likelihood_ratio(self, variance: float) -> float:
        """Return the log likelihood ratio of an exact match with a visible disc, against one more false direction."""

    def false_log_density(self, k: int, mean: float) -> float:
        """Return the log density of k false directions, whose number is geometric with that mean."""

    def refine_attitudes(
        self, starts: _Float, seen: _Float, known: _Float, variance: _Float, first: float
    ) -> tuple[_Float, _Index, _Float, _Float]:
        """Adjust each start, (h, 3, 3): return rotations, columns (h, n), information (h, 3, 3), log evidence (h,).

        Matches and Gauss-Newton steps of Wahba's problem alternate. The first matches use the variance times `first`. A
        column is the index of the known direction or -1, and the information is in 1/rad². The evidence is the density
        of all seen and unseen directions, integrated over attitudes (Laplace 1774). It is -inf if three directions do
        not determine the attitude, or if an earlier start ended with the same matches.
        """

    def two_match_log_evidence(self, hypotheses: Hypotheses, variance: _Float, sample_size: int) -> float:
        """Return the log evidence that only the two directions of a hypothesis match, summed over all hypotheses.

        A sample of `sample_size` of them gives the estimate.
        """

# spheremouse/ball/points.cpp. The tuple `view` is a rig.BallView.

def intersect(
    centre: _Float, noise: _Float, view: tuple[object, ...]
) -> tuple[_Float, _Float, _Float, _Float, _Float, _Float, _Float, _Index]:
    """Return the fields of `SpherePoints` for pixels `centre`, (n, 2), with the covariances `noise`, (n, 2, 2) px²."""

def directions_at(uv: _Float, view: tuple[object, ...]) -> tuple[_Float, _Index]:
    """Return the directions, (k, 3) unit vectors in obj, of the points seen at pixels (n, 2), and their k indices."""

# spheremouse/ball/centre_offset.cpp

def shift_of(
    points: _Points, delay: _Float, discs: tuple[_Float, _Float, _Float, _Float], reach: float
) -> tuple[int, _Float, _Float, float, float, float] | None:
    """Return the fields of `centre_offset.CentreOffset` for points, or None.

    `centre_offset.shift_of` describes the arguments. `points` is SpherePoints.measurement, and `discs` a KnownDiscs.
    """

# spheremouse/ball/outline.cpp

SLOPE: int  # samples on each side of an edge

def outline_slopes(image: _Byte, starts: _Float, steps: _Float, samples: int) -> tuple[_Float, _Float, float]:
    """Return for n lines in an image (h, w, c) the highest peak of the slopes and its place, and all slopes' median.

    A slope, in grey values, is the difference of the means of 8 samples before a sample and of 8 from it on, of the
    colour that differs most. A line begins at `starts`, (n, 2) px, and has `samples` with `steps`, (n, 2) px. Slopes
    within 14 samples of a black one do not count. A place is in samples, between them by a parabola. A line without a
    peak has 0 and place 0.
    """

# spheremouse/ball/detect/appearance.cpp

def appearance(
    directions: _Float, view: tuple[object, ...]
) -> tuple[_Float, _Float, _Float, _Float, NDArray[np.bool_]]:
    """Return the fields of `appearance.Appearance` for discs at (n, 3) unit vectors in obj."""

def seen_at(directions: _Float, view: tuple[object, ...]) -> _Float:
    """Return the pixels, (n, 2), of the ball's points at (n, 3) unit vectors in obj (`appearance.seen_at`)."""

# spheremouse/ball/detect/fit.cpp, windows.cpp

def noise_of(image: _Byte, weights: NDArray[np.float32], top: int, bottom: int, left: int, right: int) -> float:
    """Return the standard deviation of a pixel's projection by `weights`, (c,), in a window of an image (h, w, c)."""

def fit_discs(
    image: _Byte, mask: _Byte, expected: tuple[_Float, _Float, _Float], noise: float, settings: tuple[object, ...],
    contrast: float, size: float,
) -> tuple[NDArray[np.bool_], _Float, _Float, _Float, float]:  # fmt: skip
    """Fit discs expected at n places, (n, 2) px, with shapes, (n, 2, 2) px², and paths, (n, 7), in an image (h, w, c).

    `mask`, (h, w), is not 0 on the ball. A path is the motion during the exposure: way and half of its curvature, px,
    and the change of the inverse shape, px^-2. `noise` is that of a pixel, `settings` is a `windows.FitSettings`, and
    `contrast` the least one. If `size`, fitted over expected, is not 0, it is known. Return which fits are discs, their
    centroids, (n, 2) px, covariances, (n, 2, 2) px², parts of the rim that fit, (n,), and the common size, or 0.
    """

def measure_places(
    image: _Byte, places: _Float, model: tuple[object, ...], noise: float, usual: float, size: float
) -> tuple[_Float, _Float, _Float]:
    """Return centres, covariances and areas of the discs at dark spots, (n, 2) px, of an image (h, w, c).

    `model` is a `windows.DiscModel`, and `noise` is that of a pixel. `usual` is the contrast of a disc, or 0. `size` is
    the fitted over the expected one, or 0.
    """

# spheremouse/ball/detect/search.cpp

def follow_discs(
    image: _Byte, directions: _Float, model: tuple[object, ...], lattice: tuple[object, ...],
    search: tuple[int, float, float, _Float, float, float], motion: tuple[_Float, float, float], known: _Float,
    least: int,
) -> tuple[_Float, _Float, _Float, tuple[int, float, float, _Float, float, float]]:  # fmt: skip
    """Return centres, covariances and areas of the discs in an image (h, w, c), and a `search.SearchState`.

    `DiscDetector.follow` describes it. `model` is a `windows.DiscModel`, and `lattice` is `Lattice.of_turn`. Raises
    ValueError if a sample's neighbour is outside of the image.
    """

# spheremouse/ball/filters/so3_frame.cpp, so3_map.cpp, so3_match.cpp, so3_motion.cpp, so3_move.cpp, so3_update.cpp.
# Errors have the order of so3_motion.py. `body`, `pending` and `sightings` are those of So3State, `points` is
# SpherePoints.measurement, and `activity` a so3_settings.Activity. The matrix `added`, (9, 9), is process noise that
# the covariance does not include yet.

_Body = tuple[_Float, _Float, _Float, _Float, _Float, _Float, float, _Float, int, bool, int, _Float]
_Points = tuple[_Float, _Float, _Float, _Float, _Float, float, _Float]
_Innovation = tuple[_Float, _Float, _Float, _Float]
_Modes = tuple[_Float, _Float, _Float]
_Pending = tuple[_Float, float, _Float, _Modes | None]
_Sightings = tuple[_Index, _Index, _Float]
_Activity = tuple[float, float, float, _Float, _Float, _Float]
_Motion = tuple[_Float, _Float, _Float, _Float, _Float]  # attitude, rate, acceleration, landmarks, their axes
_Camera = tuple[_Float, float]  # unit vector to the camera, obj, and the least cosine with it of a disc that it sees
# rms level of the steps, normalised innovation squared, readout, rig_error, eccentricity
_Figures = tuple[float, float, float, _Float, _Float]
_Corrected = tuple[_Motion, _Float, _Float, _Figures, _Modes | None]  # with joint and weights
_Pairs = tuple[_Index, _Index, bool, float]  # as `so3.Pairing`
_Counted = tuple[_Sightings, NDArray[np.bool_], int, float]

MAX_PLACE_VARIANCE: float

def take_up(body: _Body, points: _Points, which: _Index, centre_moves: bool) -> tuple[_Float, _Float, _Float]:
    """Take up the points `which`, (k,), as landmarks: places, (k, 3) in ball, axes, (k, 3, 2), and all of `joint`.

    Unless the centre moves, noise with the squared rig variance stands for the omitted terms.
    """

def place_sigma(body: _Body, which: _Index, added: _Float) -> _Float:
    """Return the standard deviation, (k,) rad, of the predicted place of each disc of `which`, on the worse axis."""

def distances(body: _Body, points: _Points, which: _Index, added: _Float, allowance: float, gate: float) -> _Float:
    """Return squared Mahalanobis distances, (n, k), of points to the discs `which`, exact below `gate`.

    Errors of the considered parameters alone reject no disc. `allowance`, rad², is the variance of nonlinear terms.
    """

def innovation(body: _Body, points: _Points, rows: _Index, columns: _Index, added: _Float) -> _Innovation:
    """Return for k pairs H, (2k, 9), H P, (2k, n), the innovation z, (2k,) rad, and its covariance S, (2k, 2k).

    Points `rows` are paired with discs `columns`. H P includes the considered parameters and the readout. S includes
    `added` only in the terms that the linear model omits.
    """

def nearest_pairs(body: _Body, points: _Points, camera: _Camera, pending: _Pending, activity: _Activity) -> _Pairs:
    """Return the one-to-one pairs of least total distance of points and visible discs, as rows and columns.

    Pairs that contradict the others are left out. The pairs are those at the most likely level at which most points
    pair. Also return whether all that could pair does, each in its place, and the noise scale of that level, or 1 if
    some are left out.
    """

def predict_motion(
    attitude: _Float, rate: _Float, acceleration: _Float, joint: _Float, dt: float, tau: float, q: float
) -> tuple[_Float, _Float, _Float, _Float]:
    """Predict the motion by dt, s, under an acceleration that fades with the time constant tau, s (inf: it lasts).

    `attitude` is (3, 3), `rate` (3,) rad/s and `acceleration` (3,) rad/s². `joint` (n, n) is the covariance, and q the
    density of the white jerk, (rad/s³)²/Hz. Return attitude, rate, acceleration and covariance.
    """

def predict(
    body: _Body, pending: _Pending, dt: float, activity: _Activity
) -> tuple[_Float, _Float, _Float, _Float, _Float, _Float, float, _Modes | None]:
    """Predict the motion by dt, s: attitude, rate, acceleration, joint, weights, process, interval, modes of So3State.

    If dt exceeds half the mean time between two steps, the modes become one, and `interval` is the last part of dt.
    Before that part the acceleration fades (Singer 1970), which is the mean effect of the steps.
    """

def correct(
    body: _Body, points: _Points, pairs: tuple[_Index, _Index, _Float], pending: _Pending, activity: _Activity
) -> tuple[_Corrected, float]:
    """Return the state corrected by k pairs, and their log likelihood over all levels, 1/rad² each.

    `pairs` has `rows`, `columns` and `added` of `innovation`. Raises ValueError if the innovation's covariance is not
    positive definite.
    """

RARE: float
POINT_SIGMA: float

def update_by_frame(
    body: _Body, points: _Points, camera: _Camera, pending: _Pending, activity: _Activity
) -> tuple[_Corrected, _Pairs, bool]:
    """Return the state corrected by the nearest pairs of a frame, those pairs, and whether they are certain.

    Two pairs or more are certain if they are ordinary and the correction is small. Of ordinary pairs, half of those
    possible or more are in place, no other pair fits, and chance explains none. Pairs are also certain if half of the
    points pair, and all their discs are known so well that chance explains none. Errors are those of `correct`.
    """

def move(body: _Body, dx: _Float) -> tuple[_Motion, _Float, float, _Float, _Float]:
    """Return motion, covariance, readout, s, rig error and eccentricity of a state moved by errors, (n,).

    The covariance, (n, n) with n = 23 + 8p + 2l, is that of the errors about the moved state.
    """

def since_reference(P: _Float, turn: _Float) -> _Float:
    """Return the covariance, (6, 6), of the rotation vector `turn`, (3,) rad, since the reference, and of the rate.

    The turn is exp(e) R exp(-e_reference). Its error in obj is e - R e_reference, which is Jl times the error of its
    vector. `P` (n, n) is the covariance.
    """

# spheremouse/ball/filters/so3_sightings.cpp. The camera `viewer` sees directions with a cosine to viewer[0], (3,)
# obj, above viewer[1]; viewer[2] is the covariance, (3, 3) rad², of the attitude. `discs` (m, 3) are unit vectors in
# ball. `hidden` (m,) has the probabilities that something hides each.

_Viewer = tuple[_Float, float, _Float]
PLACED: float
HIDDEN_SHARE: float
ESTABLISHED_HITS: int

def carry_hidden(attitude: _Float, rate: _Float, discs: _Float, hidden: _Float, dt: float, disc_angle: float) -> _Float:
    """Return the probabilities, (m,), that something hides each disc, `dt` s later.

    The information decays as the disc travels by its own diameter, 2 `disc_angle` rad, or as hands move. `rate` (3,)
    rad/s is w_obj.
    """

def detection_probability(attitude: _Float, discs: _Float, hidden: _Float, viewer: _Viewer) -> _Float:
    """Return the probability, (m,), that each disc is detected, at R_obj_ball (3, 3)."""

def count_sightings(
    attitude: _Float, discs: _Float, sightings: _Sightings, viewer: _Viewer, columns: _Index, may_miss: bool,
    disc_angle: float,
) -> _Counted:  # fmt: skip
    """Count a frame that shows the discs `columns` in their places, and misses others if `may_miss`.

    A disc is missed only where it should be. So frames in which the attitude is known too badly count no miss.
    Return the sightings after the frame, a mask, (m,), of the discs to keep, the number of established discs seen, and
    the expected number of those missed. `hidden` changes in either case. A disc with its centre within `disc_angle`,
    rad, of a disc seen more often leaves the map.
    """

# spheremouse/wand/colour.cpp

def select_colours(image: _Byte, bounds: NDArray[np.float32]) -> tuple[_Byte, _Index, _Byte, int]:
    """Select the pixels of a BGR picture, (h, w, 3), within the bounds of each colour, (c, 6).

    Return binary pictures, (c, h, w) of 255 or 0, and their numbers of pixels, (c,). Then return a binary picture,
    (h, w), of overexposed pixels without a colour, and their number. Bounds are least and greatest hue in degrees,
    saturation from 0 to 1, and brightness from 0 to 255. A hue lies between them through 0 if the least is greater.
    """

def grow_glare(
    image: _Byte, bounds: NDArray[np.float32], distance: NDArray[np.float32], top: int, left: int, reach: float,
    pale: _Byte,
) -> None:  # fmt: skip
    """Set pixels of `pale`, (h, w), to 255 within `reach` px of an overexposed spot, and connected pale print.

    `distance`, (k, l) px, is that from the spot, for the pixels from `top`, `left` on. Pale print is within 8 px of the
    spot. It has the hue of a colour, and a quarter to all of its least saturation.
    """

def connected_areas(binary: _Byte, diagonal: bool) -> tuple[_Float, _Index, _Index]:
    """Find the connected pixels of value 255 in a picture, (h, w), in the order of their first ones.

    Return left, top, width, height, area and centre u, v of each area in px, (n, 7). Then return row and column of all
    pixels, area by area, (k, 2), and the index of each area's first pixel, (n + 1,). `diagonal` connects corners too.
    """

# spheremouse/wand/likelihood.cpp

class BallModel:
    """Ball with its points before a camera: `model.Points.table`, (p, 10), `colour`, (p,), and `lens`, (9,)."""

    def __init__(self, table: _Float, colour: _Index, radius: float, lens: _Float) -> None: ...

class FieldsView:
    """Weight fields, (c, h, w), and glare, (1, h, w) or (0, 1, 1), for the functions below, without a copy.

    `place` has left, top and factor, and `exposure_motion` is (6,). The others have a value or a row for each colour
    (`colour.Fields`); a row of `rims` has offset, its standard deviation, that of the blur (px), and the cover.
    """

    def __init__(
        self, weight: _Byte, glare: _Byte, place: _Float, fraction: _Float, rims: _Float, exposure_motion: _Float
    ) -> None: ...

def log_likelihood(
    position: _Float, rotation: _Float, ball: BallModel, fields: FieldsView, sigma: float, disc_weight: _Float,
    which: _Index,
) -> tuple[_Float, _Float]:  # fmt: skip
    """Return log-likelihood ratios and matches of n poses, (n,) each (`likelihood.log_likelihood`).

    `disc_weight`, (k, d), has weights of the points of each disc, and `which`, (n,), the row for a pose or -1.
    """

def evidence_bounds(position: _Float, rotation: _Float, ball: BallModel, fields: FieldsView) -> tuple[_Float, _Float]:
    """Return the log-likelihood ratios that n poses have if no disc shows and if all do, (n, c) of each colour."""

def expected_field(points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the expected field e of n points of discs, (n,), and de / d(rim offset in px of the field), (n,).

    Each row of `points`, (n, 9), has: the scalar product of the rim's tangent and the line of sight; that of the
    direction out of the disc; the cosine of the viewing angle; px per rad seen from the front; the distances to the
    near and the far rim, rad; the rim's curvature 1 / tan(angle); the px by which bounds select the rim outward; the
    standard deviation of its blur, px.
    """

# spheremouse/wand/limb.cpp

def measure_edges(
    image: _Byte, position: _Float, rotation: _Float, discs: _Float, ball: BallModel, factor: int
) -> _Float:
    """Return edges across the outline of a ball, (24, 5) (`limb.measure_edges`)."""

def outline_log_likelihood(position: _Float, which: _Index, edges: _Float, ball: BallModel, factor: int) -> _Float:
    """Return the log-likelihood ratios, (n,), of the edges `edges[which]` of (k, 24, 5), for balls at (n, 3) m."""

# spheremouse/wand/refine.cpp

def refine(
    position: _Float, rotation: _Float, ball: BallModel, fields: FieldsView, edges: _Float, rounds: int
) -> tuple[_Float, _Float, _Float, float, _Float]:
    """Return position, rotation, covariance, slope and rims of the peak near a pose (`likelihood.refine_pose`)."""

# spheremouse/wand/particles.cpp

class Proposal:
    """Products of m motions with k peaks, in this order, then the k peaks alone: c = m k + k components.

    `shift` (m, 6), `motion_covariance` (m, 6, 6) and `probability` (m,) are those of `MotionMixture`, `birth` too.
    `position` (k, 3), `rotation` (k, 3, 3), `covariance` (k, 6, 6) and `log_mass` (k,) are those of `PeakMixture`.
    """

    def __init__(
        self, shift: _Float, motion_covariance: _Float, probability: _Float, birth: float,
        position: _Float, rotation: _Float, covariance: _Float, log_mass: _Float,
    ) -> None: ...  # fmt: skip
    def score(self, position: _Float, rotation: _Float) -> tuple[_Float, _Float]:
        """Return log weights of the products for n particles, (n, m k), and differences from the peak, (n, m k, 6)."""

    def draw(self, chosen: _Index, difference: _Float, normal: _Float) -> tuple[_Float, _Float]:
        """Draw poses, (n, 3) m and (n, 3, 3), from the components `chosen`, (n,), with normal numbers, (n, 6)."""

    def log_ratio(
        self, base_position: _Float, base_rotation: _Float, position: _Float, rotation: _Float, difference: _Float,
        responsibility: _Float, blind: float,
    ) -> tuple[_Float, _Index]:  # fmt: skip
        """Return log p(x | parent) - log q(x | parent), (n,), and the index of the nearest peak, (n,).

        The parents are the `base` poses, with their differences and the probability of each component, (n, c).
        The fraction `blind` of the poses comes from the motions alone.
        """

# spheremouse/wand/assign.cpp

def assign_spots(
    spots: _Float, discs: _Float, glare: _Float, limits: _Float, min_score: float, first_spot: int,
    max_assignments: int, max_found: int,
) -> tuple[_Float, _Float, _Float, int]:  # fmt: skip
    """Return poses that explain spots: score, (k,), centre in radii of the ball, (k, 3), rotation, (k, 3, 3).

    Spots, (n, 4), are x, y in reduced coordinates, area and index of the colour. Discs, (m, 5), are direction, angular
    radius and index of the colour. Glare, (g, 3), is x, y and radius. `limits` are the least and the greatest radius
    of the ball over its distance, and the tolerance of a centroid. The last result is the spot at which
    `max_assignments` were reached, or 0.
    """
