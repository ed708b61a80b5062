"""Sentences for people about the ball in its frame: events, missing discs, and targets."""

from collections.abc import Iterable

import numpy as np

from spheremouse.ball import events
from spheremouse.ball.detect.diagnosis import Absence, Cause
from spheremouse.ball.detect.projection import GREY, NEGATIVE
from spheremouse.ball.detect.refused import Bound, Refused
from spheremouse.ball.detector import Words
from spheremouse.ball.events import BallLost, Doubt, Why
from spheremouse.ball.pose import Resection
from spheremouse.ball.rig import Rig
from spheremouse.errors import format_count
from spheremouse.tracker import Event

_DOUBTS = {
    Doubt.NO_DISC: "no {part} in view",
    Doubt.UNKNOWN: "no {part} in view is where one of the map should be",
    Doubt.ONE_DISC: "one known {part} in view does not determine the rotation about it",
    Doubt.UNCERTAIN: "the {parts} in view do not agree on one turn of the ball",
    Doubt.SEVERAL: "the {parts} in view leave more than one attitude possible",
    Doubt.CAMERA: "the camera is moving",
}

_SHOWN = "`spheremouse ctl snapshot`, or `preview`, shows it"
_ABSENCES = {  # reason, with a as an Absence, and remedy
    Cause.DARK: (
        "it is nearly black ({a.grey:.0f} of 255)",
        "uncover the lens, light the ball, or expose longer (camera.exposure_s)",
    ),
    Cause.BRIGHT: (
        "it is overexposed ({a.grey:.0f} of 255)",
        "a shorter exposure (camera.exposure_s), less gain, or less light",
    ),
    Cause.BLURRED: ("the picture is blurred, by {a.size:.1f} px", "focus the lens (camera.focus), and wipe it"),
    Cause.LIGHTER: ("{spots} like discs are lighter than the ball, not darker", "set discs.polarity to light"),
    Cause.DARKER: ("{spots} like discs are darker than the ball, not lighter", "set discs.polarity to dark"),
    Cause.FAINT: (
        "{spots} like discs are faint, with a contrast of {a.contrast:.2f}",
        "more light from the side of the camera, less gloss, or a smaller discs.contrast",
    ),
    Cause.SIZE: (
        "{spots} are about {a.size:.0f} px across, and the rig's discs {a.disc:.0f} px",
        "if these are the discs, correct disc_radius in the rig, or give the rig of this ball",
    ),
    Cause.SHAPE: (
        "none of {spots} looks like a disc of {a.disc:.0f} px",
        f"uncover the ball, light it evenly; is this the rig's ball? {_SHOWN}",
    ),
    Cause.PLAIN: (
        "nothing on it stands out",
        f"uncover the ball; does the camera see it, and are its discs on this side? {_SHOWN}",
    ),
    Cause.UNTURNED: (
        "nothing has turned as the ball does",
        "turn it by 10° or more; a pattern that is fainter than the noise cannot be followed",
    ),
    Cause.UNPATTERNED: (
        "{plain} of it shows no pattern above the noise",
        "paint or stick spots of many sizes all round it, give it more light, or use discs",
    ),
    Cause.UNLIKE: ("the picture does not fit its pattern", "uncover the ball, and light it as before"),
}

_REFUSALS = {  # reason, short enough for a picture, and remedy
    Bound.COLOURS: ("{inside} in {outside}, no third colour", "no target, or one that is covered in part"),
    Bound.EDGES: ("{code}: edges not clear", "focus the lens, hold the camera still, uncover all of it"),
    Bound.CENTRE: ("{code}: not concentric", "uncover all of it; is it a print of ours?"),
    Bound.SIZE: ("{code}: too small", "go nearer, choose a larger picture, or print larger targets"),
    Bound.RATIO: ("{code}: rings out of proportion", "focus the lens; is it a print of ours?"),
    Bound.LIGHT: ("{code}: too dark or too pale", "more light, or less glare (rings.saturation, rings.value)"),
    Bound.HUE: ("{code}: other hues", "white light, white balance (rings.cyan, rings.magenta, rings.yellow)"),
}


def line(happened: Iterable[Event], words: Words) -> str:
    """Return the log line of a frame's events, each with its new state; empty if there are none."""
    return "; ".join(f"{_state_prefix(e)}{sentence(e, words)}" for e in happened)


def reason(happened: Iterable[Event], words: Words) -> str:
    """Return the sentences of events for a line that has the state beside it."""
    return "; ".join(f"{_state_prefix(e) if k else ''}{sentence(e, words)}" for k, e in enumerate(happened))


def _state_prefix(event: Event) -> str:
    """Return the state that an event begins, as the log writes it; empty if it begins none."""
    match event:
        case BallLost():
            return "lost: "
        case events.Found() | events.Recognised(saved=True):
            return "tracking: "
        case _:
            return ""


def sentence(event: Event, words: Words) -> str:
    """Return an event in the words of the detector that saw the ball."""
    parts = words.parts
    match event:
        case events.Found(discs):
            return f"{discs} {parts} in view"
        case events.Turned(masked):
            more = words.masked.format(n=masked, s="s" if masked > 1 else "")
            return f"the ball turns; {more}" if masked else "the ball turns"
        case events.Recognised(discs, saved=True):
            return f"recognised by {discs} {parts} of the saved map"
        case events.Recognised(discs, older=True):
            return f"the attitude is that of the earlier map again, recognised by {discs} {parts}"
        case events.Recognised(discs):
            return f"tracking again: attitude kept, recognised by {discs} {parts}"
        case BallLost():
            return _why(event, words)
        case events.MotionWithheld(doubt):
            return f"motion withheld: {_doubt(doubt, words)}"
        case events.MotionReleased(seconds, angle):
            return f"motion goes on: the {np.degrees(angle):.0f}° of {seconds:.1f} s are made up for at a hand's pace"
        case events.NewMap(saved=True):
            return f"the saved map does not fit: another ball, or {words.altered}; the tracker begins a new map"
        case events.NewMap():
            kept = "a new map begins at the last known attitude"
            return f"tracking again: {kept}; motion that the camera did not see is not counted"
        case events.OutOfRound():
            cause = "its bearings are worn, it is out of round, the camera was moved, or the rig is wrong"
            return f"the {parts} do not fit a ball that turns about its centre: {cause}"
        case events.WrongSize(error):
            size = f"{100.0 * abs(error):.1f} % {'larger' if error > 0.0 else 'smaller'}"
            return f"the ball looks {size} than the rig has it: measure its radius and place again, or calibrate"
        case events.ReadoutKnown(readout):
            remedy = f"set readout_s: {readout:.4f} in the rig file"
            return f"rolling shutter: {1e3 * readout:.1f} ms for all rows ({remedy})"
        case events.DiscColours(weights):
            return _in_colours(weights)
        case events.AxisUnseen(ended=True):
            return "the pattern shows turns about all axes again"
        case events.AxisUnseen():
            unseen = "the pattern shows no turn about one axis, as stripes do"
            return f"{unseen}, so motion about it is not measured: add spots of many sizes"
        case events.PatternRepeats():
            return "the pattern repeats itself, so a lost ball gets a new map: add a few spots that differ"
        case events.CameraMoved(path, turn, asked):
            prefix = "" if asked else "the camera was moved: "
            return f"{prefix}new pose ({1e3 * path:.1f} mm, {np.degrees(turn):.2f}°)"
        case events.TargetsHidden():
            return "the targets are out of sight: if the camera was moved, initialise again"
        case _:
            raise AssertionError(event)


def withheld(seconds: float, doubt: Doubt, words: Words) -> str:
    """Explain why a tracked ball moves nothing, and for how long."""
    return f"motion withheld for {seconds:.1f} s: {_doubt(doubt, words)}"


def _doubt(doubt: Doubt, words: Words) -> str:
    return _DOUBTS[doubt].format(part=words.part, parts=words.parts)


def absent(seen: int, seconds: float, absence: Absence, words: Words) -> str:
    """Return the reason why a ball shows no points, or too few, since when, and the remedy."""
    found = f"only {seen} {words.part if seen == 1 else words.parts} found on the ball" if seen else words.absent
    problem, hint = why_absent(absence)
    return f"{found} for {seconds:.0f} s: {problem}; {hint}"


def why_absent(absence: Absence) -> tuple[str, str]:
    """Return the reason why no disc or pattern is found on the ball, and the remedy."""
    problem, hint = _ABSENCES[absence.cause]
    spots, plain = format_count(absence.spots, "spot"), f"{100.0 * absence.plain:.0f} %"
    return problem.format(a=absence, spots=spots, plain=plain), hint


def _in_colours(weights: tuple[float, float, float]) -> str:
    if weights == GREY.weights:
        return "the discs are darker than the ball"
    if weights == NEGATIVE.weights:
        return "the discs are lighter than the ball"
    named = ", ".join(f"{w + 0.0:.2f}" for w in weights)
    return f"the discs differ from the ball in colour (weights of blue, green, red: [{named}])"


def _why(lost: BallLost, words: Words) -> str:
    match lost.why:
        case Why.UNSEEN:
            seen = f"{lost.discs} {words.parts} in view, none where it should be"
            seen = seen if lost.discs else f"no {words.part} in view"
            return f"{seen} for {lost.figure:.1f} s"
        case Why.GAP:
            return f"no frame for {lost.figure:.1f} s"
        case Why.OFF_CENTRE:
            offset = f"{100.0 * lost.figure:.1f} % of its radius" if lost.radii else f"{1e3 * lost.figure:.0f} mm"
            return f"the ball does not turn about its centre, off by {offset}: lifted, or out of round"
        case Why.CAMERA:
            return "the camera was moved, and its pose is not found: uncover the targets, or initialise again"


def describe_camera_pose(resection: Resection, rig: Rig) -> str:
    """Return a log line: the camera's pose in `obj`, its standard deviations, and the targets that gave it."""
    pose = resection.pose
    size, unit, digits = (1.0 / rig.ball.radius, "radii", 3) if rig.scale_free else (1e3, "mm", 0)
    sigma = np.sqrt(np.maximum(np.diag(pose.covariance), 0.0))
    x, y, z = (f"{round(size * float(v), digits) + 0.0:.{digits}f}" for v in pose.position)
    position, rotation = (", ".join(f"{v:.2g}" for v in s) for s in (size * sigma[:3], np.degrees(sigma[3:])))
    fit = float(np.sqrt(np.mean(resection.residual**2)))
    return (
        f"camera pose: x {x}, y {y}, z {z} {unit} from the ball's centre (right, up, towards the camera); one standard "
        f"deviation {position} {unit} and {rotation}°; targets {', '.join(resection.codes)} fit to {fit:.3f} px"
    )


def list_targets(seen: Iterable[str], known: Iterable[str] | None) -> str:
    """List the targets in a picture by their codes, beside those of the rig, if there is one."""
    seen, known = list(seen), None if known is None else list(known)
    if known is None:
        return f"{format_count(len(seen), 'target')}{': ' if seen else ''}{' '.join(seen)}"
    present, others = [c for c in known if c in seen], sorted(set(seen) - set(known))
    text = f"{len(present)} of the rig's {len(known)} targets{': ' if present else ''}{' '.join(present)}"
    return f"{text}; not in the rig: {' '.join(others)}" if others else text


def refusal(refused: Refused) -> str:
    """Return the reason why a shape is no target, short enough for a picture."""
    return _REFUSALS[refused.bound][0].format(code=refused.code, inside=refused.code[0], outside=refused.code[-1])


def remedy(bound: Bound) -> str:
    """Return the remedy for a rejected target."""
    return _REFUSALS[bound][1]
