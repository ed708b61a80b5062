"""`spheremouse import-fictrac`: the folder of a ball, as `spheremouse ball` writes it, from a FicTrac configuration."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.commands.options import Force
from spheremouse.errors import CalibrationError

if TYPE_CHECKING:
    from spheremouse.ball.detect.detections import Image
    from spheremouse.calibrate.outline.fit import Outline
    from spheremouse.files.fictrac import FicTracConfig
    from spheremouse.geometry import Array
    from spheremouse.geometry.camera import InteriorOrientation

_MAX_AXES_ERROR = math.radians(15.0)  # of c2a_r against its corners; a square is clicked better
_MAX_CORNER_ERROR_PX = 20.0  # by which corners miss a square in perspective: otherwise they are none
_MAX_CORRECTION = 0.1  # of the radius: edges farther off are of something else
_MAX_LENGTH_ERROR = 0.01  # of the unit vector roi_c; the file has six digits
_MIN_RADIUS_PX, _MAX_ANGLE = 5.0, 1.5  # px, rad: radius of a ball; a wider cone is no ball in a picture
_IN_FRONT = 1.01  # with this margin the whole cone is in front of the image plane
_SEARCHED_FILM_S = 10.0  # of the film, in which the edge is looked for
# Corners of a square in the animal's axes, in the order in which configGui takes them (FicTrac's include/geometry.h).
_SQUARES = {
    "c2a_cnrs_xy": ((1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 0)),
    "c2a_cnrs_yz": ((0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)),
    "c2a_cnrs_xz": ((1, 0, -1), (-1, 0, -1), (-1, 0, 1), (1, 0, 1)),
}


def import_fictrac(
    config: Annotated[Path, typer.Argument(metavar="CONFIG.TXT", show_default=False, help="FicTrac's configuration.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write.")] = Path("ball"),
    source: Annotated[
        str | None,
        typer.Option(metavar="KIND:ARG", help="Film or camera, as of `run --source`, in place of src_fn."),
    ] = None,
    force: Force = False,
) -> None:
    """Write the folder of `spheremouse ball` from a configuration of FicTrac 2.1, with its laboratory axes and masks.

    The film, or the camera, of src_fn is opened for the size of its pictures. If the ball turns in it, the outline of
    roi_c and roi_r, or of roi_circ, is refined by the ball's edge. Each key is listed: used, or why it is not needed.
    """
    from spheremouse.calibrate.outline.fit import pinhole, rig_of
    from spheremouse.commands.ball import film, source_spec
    from spheremouse.commands.ball.folder import check_folder, describe, draw_outline, next_steps, write_folder
    from spheremouse.files.config import to_yaml
    from spheremouse.files.fictrac import KEYS, read_fictrac
    from spheremouse.output.fictrac import R_LAB_OBJ

    fictrac = read_fictrac(config)
    check_folder(out, [config], force)
    _check_values(fictrac)
    spec = source_spec(_source_of(fictrac) if source is None else source)
    images, _ = film(spec, _SEARCHED_FILM_S)
    camera = pinhole(images[0].shape[1::-1], fictrac.values["vfov"])
    R, axes = lab_axes(fictrac, camera)
    outline, origin = _refined_by_edge(images, outline_of(fictrac, camera), camera)
    rig, masks = rig_of(outline, camera, R_LAB_OBJ.T @ R), fictrac.values.get("roi_ignr", ())
    settings = ["discs:", "  masks:", *(f"    - {to_yaml(mask)}" for mask in masks)] if masks else []
    if (port := int(fictrac.values.get("sock_port", -1))) > 0:
        host = fictrac.values.get("sock_host", "127.0.0.1")
        settings.append(f"output: {to_yaml(f'udp:{host}:{port},format=fictrac')}")
    picture = draw_outline(images[-1], outline.pixels(camera), (), masks)
    write_folder(out, rig, picture, spec, settings, "spheremouse import-fictrac")
    reasons = {key: f"not needed: {reason}" for key, (_, reason) in KEYS.items() if reason} | {"c2a_r": axes}
    reasons |= {key: "not needed: c2a_src names others" for key in _SQUARES if key != fictrac.values.get("c2a_src")}
    reasons |= {"roi_circ": "not needed: roi_c and roi_r count"} if "roi_r" in fictrac.values else {}
    for key, line in sorted(fictrac.lines.items(), key=lambda each: each[1]):
        print(f"{config}:{line}: {key}: {reasons.get(key, 'used')}")
    print(f"{origin}\n{describe(outline, rig)}\n{next_steps(out, 'text:ball.dat,format=fictrac')}")
    angle = math.degrees(math.acos(min(1.0, outline.direction[2])))
    print(
        f"FicTrac's rates differ by a rotation of {angle:.1f}°: it takes the direction to the ball for the optical axis"
    )


def _check_values(fictrac: "FicTracConfig") -> None:
    """Raise ConfigurationError for values with which there is no camera, outline or mask."""
    if "vfov" not in fictrac.values:
        fictrac.refuse("vfov", "missing", "give the vertical field of view in degrees")
    if not 0.1 <= fictrac.values["vfov"] <= 150.0:
        fictrac.refuse("vfov", f"is {fictrac.values['vfov']:g}°", "give 0.1 to 150 degrees")
    if fictrac.values.get("fisheye"):
        fictrac.refuse(
            "fisheye", "this camera model is not known here", "calibrate the camera, then use `spheremouse ball`"
        )
    for mask in fictrac.values.get("roi_ignr", ()):
        if len(mask) < 6 or len(mask) % 2:
            fictrac.refuse("roi_ignr", f"a polygon has {len(mask)} numbers", "give x, y of three or more corners")


def _source_of(fictrac: "FicTracConfig") -> str:
    """Return the source of src_fn: the number of a camera, or a film's path, relative as for FicTrac or to the file."""
    name = fictrac.values.get("src_fn", "")
    if name.isdecimal():
        return f"opencv:{name}"
    for path in (Path(name), fictrac.path.parent / name):
        if path.is_file():
            return f"video:{path}"
    fictrac.refuse("src_fn", f"{name or 'missing'}: no such file", "name the film or the camera by --source")


def outline_of(fictrac: "FicTracConfig", camera: "InteriorOrientation") -> "Outline":
    """Return the ball's cone, in cam: of roi_c and roi_r if both are given, as in FicTrac, else the fit to roi_circ.

    Raises ConfigurationError for values with which there is none.
    """
    import numpy as np

    from spheremouse.calibrate.outline.fit import Outline, fit_outline, rays_of
    from spheremouse.commands.ball import POINT_PX, check_points

    focal, hint = math.sqrt(camera.fx * camera.fy), "run configGui, or use `spheremouse ball`"
    sigma = POINT_PX / focal
    if "roi_c" in fictrac.values and "roi_r" in fictrac.values:
        direction, angle = np.array(fictrac.numbers("roi_c", 3)), fictrac.values["roi_r"]
        length = float(np.linalg.norm(direction))
        hint = "delete both lines: roi_circ has the points" if fictrac.values.get("roi_circ") else hint
        if abs(length - 1.0) > _MAX_LENGTH_ERROR:
            fictrac.refuse("roi_c", f"must be a unit vector, has the length {length:.3g}", hint)
        whole_in_front = direction[2] > _IN_FRONT * math.sin(angle)
        if not (_MIN_RADIUS_PX / focal < angle < _MAX_ANGLE and whole_in_front):
            fictrac.refuse("roi_c", "is, with roi_r, no ball before the camera", hint)
        # configGui fitted both to points that a person clicked: they are about as exact as one of these
        return Outline(direction / length, angle, sigma**2 * np.eye(3))
    if "roi_circ" not in fictrac.values:
        fictrac.refuse("roi_circ", "missing, and roi_c and roi_r are not both given", hint)
    points = np.array(fictrac.numbers("roi_circ", 2, 6)).reshape(-1, 2)
    try:
        outline = fit_outline(rays_of(points, camera), sigma)
        check_points(points, outline, camera)
    except CalibrationError as e:
        fictrac.refuse("roi_circ", e.problem, e.hint)
    return outline


def _refined_by_edge(images: "list[Image]", given: "Outline", camera: "InteriorOrientation") -> "tuple[Outline, str]":
    """Return the outline by the ball's edge in the pictures, or the given one, and a line about its origin."""
    import numpy as np

    from spheremouse.calibrate.outline.find import find_outline

    try:
        found, _ = find_outline(images, camera, given)
    except CalibrationError as e:
        return given, f"outline: as configured, since {e.problem}"
    correction = np.array([*(found.direction - given.direction), found.angle - given.angle])
    if np.abs(correction).max() > _MAX_CORRECTION * given.angle:
        return given, "outline: as configured; the edge of what turns in the film is elsewhere, so look at the picture"
    px = np.abs(correction).max() * math.sqrt(camera.fx * camera.fy)
    return found, f"outline: by the edge of the ball in the film, {px:.1f} px from the configured one"


def lab_axes(fictrac: "FicTracConfig", camera: "InteriorOrientation") -> "tuple[Array, str]":
    """Return the rotation from the camera's axes to FicTrac's laboratory axes, (3, 3), and words about its origin.

    It is that of c2a_r, else of the corners of c2a_src. Versions before 2.1 wrote the inverse into c2a_r.
    """
    import numpy as np

    from spheremouse.geometry.rotation import exp, log

    by_corners = _axes_by_corners(fictrac, camera)
    if "c2a_r" not in fictrac.values:
        if not by_corners:
            hint = "run configGui, or use `spheremouse ball`: its axes are the camera's"
            fictrac.refuse("c2a_r", "missing, and no square of c2a_src gives it", hint)
        return by_corners[0], "used"
    R = exp(np.array(fictrac.numbers("c2a_r", 3)))
    errors = [min((float(np.linalg.norm(log(S @ A.T))) for S in by_corners), default=0.0) for A in (R, R.T)]
    if errors[1] < _MAX_AXES_ERROR < errors[0]:
        return R.T, "used, inverted: its corners show that FicTrac before 2.1 wrote it"
    doubt = f"used; its corners differ by {math.degrees(errors[0]):.0f}°, look at FicTrac's configImg"
    return R, doubt if errors[0] > _MAX_AXES_ERROR else "used"


def _axes_by_corners(fictrac: "FicTracConfig", camera: "InteriorOrientation") -> "list[Array]":
    """Return the rotations from the camera that the corners of c2a_src allow, the best first; none without corners."""
    import cv2
    import numpy as np

    name = fictrac.values.get("c2a_src", "")
    if name not in _SQUARES or len(fictrac.values.get(name, ())) != 8:
        return []
    corners, square = np.reshape(fictrac.values[name], (4, 1, 2)), np.array(_SQUARES[name], float)
    try:
        _, found, _, errors_px = cv2.solvePnPGeneric(square, corners, camera.matrix, None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:
        return []
    rotations = [np.asarray(cv2.Rodrigues(rotation)[0].T, float) for rotation in found]
    return [
        R
        for R, px in zip(rotations, np.ravel(errors_px), strict=False)
        if px < _MAX_CORNER_ERROR_PX and np.isfinite(R).all()
    ]
