"""The picture, with the rig: targets and camera pose, the ball, its brightness and discs, and motion blur."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from spheremouse.ball.build import build, detector_of
from spheremouse.ball.detect.appearance import ball_outline, largest_disc
from spheremouse.ball.detect.choose_projection import best_projection
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.diagnosis import why_no_disc
from spheremouse.ball.detect.discs import DiscDetector, DiscSettings, disc_detector
from spheremouse.ball.detect.projection import GREY, Projection
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.points import directions_at
from spheremouse.ball.pose import TARGET_SIGMA_PX, find_pose, gather
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.errors import SpheremouseError
from spheremouse.finding import Finding, Verdict, classify, ok, refused, unchecked, wrong
from spheremouse.geometry.camera import Pose
from spheremouse.session.messages import why_absent
from spheremouse.tracker import Frame

_TARGET_STABILITY_M = 1e-3  # m: stability of a target on a frame of wood or steel
_USUAL_RADIUS = 0.6  # m, of a ball without a measured size
_BRISK_SPEED_M_S = 1.0  # m/s of the ball's surface: an arm's length in less than a second
_CORE_DIAMETERS = 0.5  # of a disc's diameter
_MIN_DISCS = 3  # directions that determine an attitude and check it
_MIN_OVEREXPOSED_GREY = 254  # grey value: the last two values have all overexposed pixels at any noise
_LIGHT_DISCS = 99.8  # per cent of the ball that are darker than light discs: eight of 2 cm on 1.2 m cover 0.2 %
_BRIGHT_PERCENTILE = 95.0  # per cent of the picture that are darker
_MAX_CLIPPED = 0.1  # of the ball overexposed: one disc in ten has a rim with a clipped bright side
_PRINT_CONTRAST = 0.8  # contrast of black print on white


@dataclass(frozen=True, slots=True)
class Sight:
    """The camera's pose with the detector for it."""

    rig: Rig
    pose: Pose
    detector: DiscDetector

    @property
    def projection(self) -> Projection:
        """Projection of the colours in which discs are darker than the ball."""
        return self.detector.model.fit.projection

    @property
    def disc(self) -> float:
        """Diameter of a disc in the middle of the ball, px."""
        return self.detector.model.diameter


def targets(views: tuple[Frame, ...], rig: Rig, settings: Settings) -> tuple[Pose | None, Finding]:
    """Return the camera's pose from the targets, and a finding about their residual.

    If the rig has a pose, that one is returned. The pose is None with fewer than three targets, in grey pictures, or if
    none is found.
    """
    if rig.pose is not None:
        return rig.pose, ok("targets", "none are needed: the rig knows where the camera is")
    if len(rig.targets.codes) < 3:
        return None, wrong(
            "targets", "the rig has fewer than three", "calibrate the device: spheremouse calibrate next"
        )
    colour = [v.image for v in views if v.image.ndim == 3]
    if not colour:
        return None, unchecked("targets", "the pictures are grey", "choose a format with colour: YUYV or MJPG")
    looked = [detect_targets(i, rig.targets.radii, settings.rings) for i in colour]
    seen = sorted({s.code for s in gather(looked)} & set(rig.targets.codes))
    numbers: dict[str, Any] = {"seen": len(seen), "of": len(rig.targets.codes), "codes": seen}
    try:
        found = find_pose(looked, rig, colour[0])
    except SpheremouseError as e:
        return None, refused("targets", e, **numbers)
    residual, all_codes = float(np.sqrt(np.mean(found.residual**2))), rig.targets.codes
    limit = expected_residual(rig, found.pose, TARGET_SIGMA_PX)
    numbers |= {"seen": len(found.codes), "residual_px": round(residual, 3), "limit_px": round(limit, 3)}
    listed = ", ".join(found.codes)
    hidden = ", ".join(c for c in all_codes if c not in found.codes)
    hint = "was a target moved, the lens turned, or the camera exchanged? calibrate what has changed"
    only_three = len(found.codes) == 3 < len(all_codes)
    return found.pose, classify(
        "targets",
        f"{len(found.codes)} of {len(all_codes)} found ({listed}), residual {residual:.2f} px",
        (residual > limit, Verdict.WARNING, f"; up to {limit:.2f} px is usual", hint),
        (only_three, Verdict.WARNING, ": nothing checks them", f"uncover or light {hidden}"),
        **numbers,
    )


def expected_residual(rig: Rig, pose: Pose, sigma: float) -> float:
    """Return three standard deviations of a target's residual, px: of its measurement and of its place in the rig."""
    unit = rig.ball.radius / _USUAL_RADIUS if rig.scale_free else 1.0
    depth = np.maximum(pose.to_cam(rig.targets.position)[:, 2], 1e-6)
    stability = rig.camera.fx * _TARGET_STABILITY_M * unit / float(np.median(depth))
    rig_sigma = rig.camera.fx * np.sqrt(np.mean(np.diag(rig.targets.covariance))) / float(np.median(depth))
    return 3.0 * float(np.sqrt(sigma**2 + stability**2 + rig_sigma**2))


def sight(rig: Rig, pose: Pose, settings: Settings) -> tuple[Sight | None, Finding]:
    """Return pose and detector, None if the ball is not in view, and a finding about the size of ball and discs.

    There is no detector of discs, and None, for a ball that is followed by its pattern.
    """
    try:
        build(rig, pose, settings)  # PoseError without the ball in the picture
        follows = detector_of(rig, settings)
        detector = disc_detector(settings.discs, rig, pose) if follows.sees_discs else None
    except SpheremouseError as e:
        return None, refused("ball", e)
    rim = ball_outline(rig, pose)
    c = rig.camera
    inside = np.all((rim > -0.5) & (rim < (c.width - 0.5, c.height - 0.5)), axis=1)
    across = float(np.ptp(rim, axis=0).mean())
    disc = largest_disc(rig, pose)
    distance = float(np.linalg.norm(pose.position - rig.ball.centre)) / (rig.ball.radius if rig.scale_free else 1.0)
    unit = "radii" if rig.scale_free else "m"
    area, least = 0.25 * np.pi * disc**2, settings.discs.min_area
    closer = "a camera closer by, a longer lens, or more pixels"
    cut = f"; {100 * (1.0 - float(inside.mean())):.0f} % of its outline is out of the picture"
    text, numbers = f"{across:.0f} px across, {distance:.2f} {unit} from the camera", {"ball_px": round(across, 1)}
    numbers["distance"] = round(distance, 3)
    if detector is None:
        text += f"; followed by its {follows.words.subject}, which the tracker learns as the ball turns"
        return None, classify("ball", text, (not inside.all(), Verdict.WARNING, cut, "turn the camera"), **numbers)
    # a disc that is seen at 75 degrees has a quarter of its area
    return Sight(rig, pose, detector), classify(
        "ball",
        f"{text}; a disc is {disc:.1f} px",
        (area < least, Verdict.WRONG, ": none is large enough to be found", closer),
        (area < 4.0 * least, Verdict.WARNING, ": found in the middle of the ball only", closer),
        (not inside.all(), Verdict.WARNING, cut, "turn the camera"),
        disc_px=round(disc, 2),
        **numbers,
    )


def in_colours(seen: Sight, views: tuple[Frame, ...]) -> Sight:
    """Return the sight for the lens's blur, and the projection that shows the discs best, unless the settings fix it.

    Most views decide.
    """
    if blurs := [blur for v in views if (blur := seen.detector.lens_blur(v.image)) is not None]:
        seen = replace(seen, detector=seen.detector.with_lens_blur(float(np.median(blurs))))
    if seen.detector.settings.projection is not None:
        return seen
    found = Counter(best_projection(v.image, seen.detector, seen.projection)[0] for v in views)
    return replace(seen, detector=seen.detector.with_projection(found.most_common(1)[0][0])) if found else seen


def contrasts(settings: Settings, rig: Rig | None) -> DiscSettings:
    """Return the settings with the least contrast: for a ball that is followed by its pattern, that of print."""
    sees_discs = rig is None or detector_of(rig, settings).sees_discs
    return settings.discs if sees_discs else replace(settings.discs, contrast=_PRINT_CONTRAST)


def brightness(
    views: list[Image], mask: Image | None, settings: DiscSettings, noise: float, projection: Projection = GREY
) -> Finding:
    """Check the grey values of the ball's surface in `views` (h, w), where `mask` (h, w) is not 0.

    Without a mask, check the brightest part of the picture.

    A disc of the lowest contrast must exceed the noise at its edge, where half of it is left, by four standard
    deviations and a grey value, as in the detector. The contrast is relative to the lighter of disc and ball, which is
    the disc in any `projection` but grey.
    """
    values = np.concatenate([v[mask > 0] if mask is not None else v.ravel() for v in views])
    middle = float(np.median(values) if mask is not None else np.percentile(values, _BRIGHT_PERCENTILE))
    level = middle if projection == GREY else float(np.percentile(values, _LIGHT_DISCS))
    clipped = float(np.mean(values >= _MIN_OVEREXPOSED_GREY))
    least, hopeless = ((4.0 * noise + 1.0) / (0.5 * c) for c in (settings.contrast, _PRINT_CONTRAST))
    ball, where = (True, "the ball") if mask is not None else (False, "the brightest of the picture")
    darken = "a shorter exposure (camera.exposure_s), less gain, or a lamp less"
    lighten = "more light on the ball; then gain, then exposure"
    hidden = f": even black print stands out of the noise from {hopeless:.0f} on"
    return classify(
        "brightness",
        f"{where} is at {middle:.0f} of 255, noise {noise:.1f}, {100 * clipped:.1f} % overexposed",
        (ball and clipped > 0.5, Verdict.WRONG, ": most of it shows nothing", darken),
        (ball and level < hopeless, Verdict.WRONG, hidden, lighten),
        (ball and clipped > _MAX_CLIPPED, Verdict.WARNING, ": these parts are measured badly", darken),
        (level < least, Verdict.WARNING, f": discs in haze or shade need {least:.0f}", lighten),
        grey=round(middle, 1),
        noise=round(noise, 2),
        blown_out=round(clipped, 4),
        least=round(least, 1),
    )


def discs(views: tuple[Frame, ...], seen: Sight, settings: DiscSettings) -> Finding:
    """Report the median number of disc candidates in a view, and the median contrast of the clear ones.

    The detector learns contrast from discs with a semi-minor axis above 3 px. Without one, the contrast is unknown.
    If most views show none, report the cause in the view with the fewest. Contrast does not change the verdict: the
    detector has left out weaker discs.
    """
    counts, contrasts = [], []
    for view in views:
        found = seen.detector.detect(view.image)
        counts.append(len(found))
        directions, _ = directions_at(found.centre, seen.rig, seen.pose)
        _, learnt = seen.detector.follow(view.image, SearchState(), directions, least=len(directions) + 1)
        contrasts += [learnt.contrast] if learnt.contrast > 0.0 else []
    count = int(np.median(counts))
    numbers: dict[str, Any] = {"seen": count, "least": min(counts), "most": max(counts)}
    if count == 0:
        absence = why_no_disc(views[int(np.argmin(counts))].image, seen.rig, seen.pose, settings)
        problem, hint = why_absent(absence)
        return wrong("discs", f"none is seen on the ball: {problem}", hint, **numbers, cause=str(absence.cause))
    text = f"{count} seen"
    if contrasts:
        strength = float(np.median(contrasts))
        numbers["contrast"] = round(strength, 3)
        text += f", contrast {strength:.2f} (black print has 0.8; {settings.contrast:g} is the least that counts)"
    else:
        text += ", contrast not measured: no clear disc of 6 px"
    few = ": fewer than three, nothing checks the attitude"
    return classify(
        "discs", text, (count < _MIN_DISCS, Verdict.WARNING, few, "uncover the ball, or add discs"), **numbers
    )


def blur(seen: Sight, exposure: float | None, settings: DiscSettings, known: bool) -> Finding:
    """Report the motion of a disc during the exposure. `known` is True if the rig has the exposure.

    At a fast turn the disc in the middle of the ball moves by speed * f / distance. If it smears by more than
    `size_tolerance` of its diameter, its size is rejected. If the rig has the exposure, half of the disc must stay
    dark. If it smears by its whole diameter, no dark core is left.
    """
    rig, pose = seen.rig, seen.pose
    near = float(np.linalg.norm(pose.position - rig.ball.centre)) - rig.ball.radius
    speed = _BRISK_SPEED_M_S * (rig.ball.radius / _USUAL_RADIUS if rig.scale_free else 1.0)
    rate = speed / rig.ball.radius
    per_second = speed * rig.camera.fx / near  # px/s
    at = f"{np.degrees(rate):.0f} °/s"
    fraction = _CORE_DIAMETERS if known and exposure else settings.size_tolerance
    longest_ms = 1e3 * fraction * seen.disc / per_second
    if not exposure:
        return unchecked(
            "blur",
            f"the exposure is not known; up to {longest_ms:.1f} ms keep discs sharp at {at}",
            "set camera.exposure_s, or exposure_s in the rig file",
            longest_ms=round(longest_ms, 2),
        )
    smear, turn = per_second * exposure, float(np.degrees(rate * exposure))
    shorter = f"an exposure of {longest_ms:.1f} ms or less (camera.exposure_s), and more light"
    alternative = "" if known else "; or exposure_s in the rig file, so that blur is expected"
    return classify(
        "blur",
        f"{1e3 * exposure:g} ms are {turn:.2f}° or {smear:.1f} px at {at}; a disc is {seen.disc:.1f} px",
        (smear >= seen.disc, Verdict.WRONG, ": a turning ball shows no disc", shorter),
        (smear > fraction * seen.disc, Verdict.WARNING, "", shorter + alternative),
        exposure_ms=1e3 * exposure,
        blur_px=round(smear, 2),
        blur_deg=round(turn, 3),
        disc_px=round(seen.disc, 2),
        at_deg_s=round(float(np.degrees(rate)), 1),
        longest_ms=round(longest_ms, 2),
    )


def grey(image: Image) -> Image:
    """Return a picture in grey, (h, w)."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
