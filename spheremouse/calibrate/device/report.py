"""What a calibration of a device found, as a page with pictures.

The tables are those of Wittich 2017 (9-13) in our numbers. Lengths are in mm, or in thousandths of the ball's radius
where there are no metres.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.calibrate.device.adjust import DeviceCalibration
from spheremouse.calibrate.device.advice import coverage, photo_px
from spheremouse.calibrate.device.figures import certainty, magnification, overview, photo_picture, side_views
from spheremouse.calibrate.device.plans import Advice
from spheremouse.calibrate.device.results import (
    advice_or_made,
    correlation,
    distance_rows,
    per_photo,
    points,
    px,
    sigma_of,
    unit_of,
)
from spheremouse.calibrate.photos import Photo, image
from spheremouse.files.atomic import write_atomically
from spheremouse.files.report import page
from spheremouse.geometry.rotation import Array

MARKS = {"good": ("✓", "green"), "note": ("·", "cyan"), "warning": ("!", "red")}
AXES = ("X", "Y", "Z")


def write_device_report(
    path: Path,
    calibration: DeviceCalibration,
    photos: Sequence[Photo],
    provenance: Mapping[str, Any],
    advice: Sequence[Advice] | None = None,
) -> None:
    """Write one HTML file that needs nothing beside it; `photos` are all that were given.

    `provenance` as in rig files: date, made_by, files used.
    """
    c = calibration
    names = [p.path.name for p in photos]
    blocks = [
        page.numbers(_headlines(c)),
        page.advice([(a.kind, a.text) for a in advice_or_made(c, names, advice)]),
        _places(c),
        _ball_section(c),
        _target_section(c),
        *([_distance_section(c)] if c.device.distances else []),
        _photo_section(c, photos),
        _disc_section(c),
        _weight_section(c),
        _provenance_section(c, photos, provenance),
    ]
    lead = f"{len(c.photos)} of {len(photos)} photos, {len(c.targets)} targets, {len(c.discs)} discs"
    foot = " · ".join(str(provenance[key]) for key in ("made_by", "date") if key in provenance)
    write_atomically(path, page.page("Calibration of the device", lead, blocks, foot))


def _headlines(c: DeviceCalibration) -> list[tuple[str, str, str]]:
    unit, f, digits = unit_of(c)
    ball = np.sqrt(np.diag(c.ball_covariance))
    centre = f"X {f * ball[0]:.{digits}f}, Y {f * ball[1]:.{digits}f}, Z {f * ball[2]:.{digits}f} {unit}"
    first = (
        ("Scale", "free", "no tape distance: counts per radian")
        if c.scale_free
        else ("Ball's radius", f"{f * c.radius:.1f} {unit}", f"± {f * ball[3]:.{digits}f} {unit}")
    )
    return [
        first,
        ("Ball's centre", f"± {f * float(ball[:3].max()):.{digits}f} {unit}", centre),
        ("Discs", str(len(c.discs)), f"on {100.0 * coverage(c.directions):.0f} % of the ball"),
        ("Image points", f"{c.rms_px:.3f} px", f"RMS; {points(c)}"),
    ]


def _places(c: DeviceCalibration) -> str:
    heading = "Where everything is"
    above = page.figure(
        overview(c),
        "Cameras (blue, with the number of the photo), targets with their ids, discs, and the ball. Discs on the "
        "far side are pale. The arrows are the axes from the ball's centre, dashed within the ball: X right, Y up, "
        "Z towards the camera.",
    )
    below = page.figure(side_views(c), "The same, all at one scale. The more the cameras surround it, the better.")
    drawing, times = certainty(c)
    errors = page.figure(
        drawing,
        f"How certain the places of targets (gold) and discs (blue) are: ellipses of one standard deviation, drawn "
        f"{times:g} times larger. Where all point away from the middle, it is the scale that is uncertain.",
    )
    return page.section(heading, above, below, errors)


def _ball_section(c: DeviceCalibration) -> str:
    unit, f, digits = unit_of(c)
    sigma, r = np.sqrt(np.diag(c.ball_covariance)), correlation(c.ball_covariance)
    values = [*c.centre, c.radius]
    rows = [
        [name, f"{f * v:.{digits}f}", f"{f * s:.{digits}f}", *(f"{r[i, j]:+.3f}" if j < i else "" for j in range(3))]
        for i, (name, v, s) in enumerate(
            zip(("centre X", "centre Y", "centre Z", "radius"), values, sigma, strict=True)
        )
    ]
    text = (
        f"The ball's centre as seen from target {c.device.axes.origin}, along the axes that the targets define, and "
        "its radius. A correlation near 1 or -1 says that two errors come together: a ball a little farther off and "
        "a little larger looks the same. The tracker is told. (Wittich 2017, table 11.)"
    )
    if c.scale_free:
        text += " Lengths are in thousandths of the radius; the radius' own sigma is against the targets' distances."
    elif c.out_of_round:
        text += f" The ball is out of round by {f * c.out_of_round:.{digits}f} {unit} (standard deviation)."
    head = ["", unit, f"sigma {unit}", "correlation X", "Y", "Z"]
    return page.section("The ball", page.paragraph(text), page.table(head, rows))


def _target_section(c: DeviceCalibration) -> str:
    unit, f, digits = unit_of(c)
    point = c.measured.point[c.measured.used]
    rows = [
        [
            str(id_),
            code,
            *(f"{f * v:.{digits}f}" for v in place),
            *(f"{f * s:.{digits}f}" for s in sigma),
            str(int(np.count_nonzero(point == i))),
        ]
        for i, (id_, code, place, sigma) in enumerate(
            zip(c.device.ids, c.device.codes, c.targets, sigma_of(c, "targets"), strict=True)
        )
    ]
    text = "Centres of the targets as seen from the ball's centre: by these the camera knows where it is in play."
    head = ["id", "code", *(f"{a} {unit}" for a in AXES), *(f"sigma {a}" for a in AXES), "photos"]
    return page.section("Targets", page.paragraph(text), page.table(head, rows, text=2))


def _distance_section(c: DeviceCalibration) -> str:
    text = (
        "Tape distances as measured, and as photos and all distances together have them. Beyond 3 sigma a distance "
        "would be suspect. Checked: at 0 % nothing would contradict it whatever it says, at 100 % the others know it."
    )
    head = ["from - to", "tape mm", "sigma", "adjusted mm", "sigma", "residual mm", "over sigma", "checked"]
    return page.section("Distances", page.paragraph(text), page.table(head, distance_rows(c)))


def _photo_section(c: DeviceCalibration, photos: Sequence[Photo]) -> str:
    unit, f, _ = unit_of(c)
    rows, certain, pictures = [], [], []
    expected = photo_px(c)[1]
    for i, (k, pose, (used, rejected, rms)) in enumerate(zip(c.photos, c.poses, per_photo(c), strict=True)):
        name, number = photos[k].path.name, str(k + 1)
        place = [f"{f * v:.0f}" for v in pose.position]
        rows.append([number, name, *place, str(used), str(rejected or "-"), px(rms), px(expected[i])])
        certain.append([number, *_pose_sigma(c, np.diag(pose.covariance))])
        count = f"{used} points" + (f", {rejected} not used" if rejected else "")
        pictures.append(page.picture(photo_picture(c, i, image(photos[k])), f"{number}: {name}; {count}, {px(rms)} px"))
    certain.append(["RMS", *_pose_sigma(c, np.mean([np.diag(pose.covariance) for pose in c.poses], axis=0))])
    head = ["", "photo", *(f"{a} {unit}" for a in AXES), "points", "not used", "px RMS", "expected"]
    spread = ["", *(f"sigma {a} {unit}" for a in AXES), *(f"about {a} °" for a in AXES)]
    times = magnification(c, photos[c.photos[0]].size[0])
    table = page.paragraph(
        "Where the camera stood in each photo, as seen from the ball's centre, how certain that is, and how certain "
        "its attitude about the three axes is, in degrees. (Wittich 2017, tables 10 and 12.) The more discs a photo "
        "shows aslant, near the ball's edge, the farther off its points are expected to be: they count for less."
    )
    drawn = page.paragraph(
        f"Green: targets; blue: discs; red crosses: seen, but contradicted by the other photos and not used. Arrows "
        f"show by how much a point is off, {times:g} times longer. Arrows that point alike in one part of the picture "
        "mean a lens that differs from the camera file's. The white outline is that of the adjusted ball: it must fit."
    )
    pairs = [page.beside(*pictures[i : i + 2]) for i in range(0, len(pictures), 2)]  # a pair stays on one printed page
    tables = page.table(head, rows, text=2), page.table(spread, certain)
    return page.section("Photos", table, *tables, _left_out(c, photos), drawn, *pairs)


def _pose_sigma(c: DeviceCalibration, variance: Array) -> list[str]:
    _, f, digits = unit_of(c)
    sigma = np.sqrt(variance)
    return [*(f"{f * s:.{digits}f}" for s in sigma[:3]), *(f"{np.degrees(s):.3f}" for s in sigma[3:])]


def _left_out(c: DeviceCalibration, photos: Sequence[Photo]) -> str:
    rows = [[photos[k].path.name, "nothing", why] for k, why in c.skipped]
    rows += [[photos[k].path.name, "targets only", why] for k, why in c.doubtful]
    return page.table(["photo", "used", "why"], rows, faulty=[True] * len(rows), text=3) if rows else ""


def _disc_section(c: DeviceCalibration) -> str:
    unit, f, digits = unit_of(c)
    block, rows = c.block("discs"), []
    for i, (place, seen) in enumerate(zip(c.discs, c.sightings, strict=True)):
        here = slice(block.start + 3 * i, block.start + 3 * i + 3)
        sigma, r = np.sqrt(np.diag(c.covariance[here, here])), correlation(c.covariance[here, here])
        rows.append(
            [
                str(i + 1),
                *(f"{f * v:.{digits}f}" for v in place),
                *(f"{r[a, b]:+.3f}" for a, b in ((0, 1), (0, 2), (1, 2))),
                *(f"{f * s:.{digits}f}" for s in sigma),
                str(int(seen)),
            ]
        )
    columns = c.solution.columns.point(np.arange(len(c.targets), len(c.targets) + len(c.discs)))
    alone = np.sqrt(np.diag(c.solution.covariance)[columns]) / c.unit
    mean = [
        [name, *(f"{f * v:.{digits}f}" for v in np.sqrt(np.mean(s**2, axis=0)))]
        for name, s in (("from the photos alone", alone), ("on the ball, from its centre", sigma_of(c, "discs")))
    ]
    return page.section(
        "Discs",
        page.paragraph("Standard deviations of all discs, root mean square. (Wittich 2017, table 9.)"),
        page.table(["", *(f"{a} {unit}" for a in AXES)], mean),
        page.paragraph(
            "Each disc as seen from the ball's centre, how its coordinates go together, and how many photos show it: "
            "the fewer, the less is checked. In play the map is refined. (Wittich 2017, table 13.)"
        ),
        page.table(
            ["", *(f"{a} {unit}" for a in AXES), "rho XY", "XZ", "YZ", *(f"sigma {a}" for a in AXES), "photos"], rows
        ),
    )


def _weight_section(c: DeviceCalibration) -> str:
    point, used = c.measured.point, c.measured.used
    is_target = (point >= 0) & (point < len(c.targets))
    rows = []
    for name, factor, mine in (
        ("targets", c.variance_factors[0], used & is_target),
        ("discs", c.variance_factors[1], used & ~is_target),
    ):
        residual = c.measured.residual[mine]
        rows.append([name, str(int(np.count_nonzero(mine))), f"{np.sqrt(np.mean(residual**2)):.3f}", f"{factor:.2f}"])
    text = (
        "How well image points fit, and the variance found over the variance assumed: about 1 or less is as it should "
        "be; 4 means twice as far off as usual. All uncertainties on this page have it in them."
    )
    return page.section(
        "Weights", page.paragraph(text), page.table(["", "image points", "px RMS", "variance factor"], rows)
    )


def _provenance_section(c: DeviceCalibration, photos: Sequence[Photo], provenance: Mapping[str, Any]) -> str:
    known = [[str(key).replace("_", " "), str(value)] for key, value in provenance.items() if isinstance(value, str)]
    files = [
        [photo.path.name, "used" if k in c.photos else "left out", f"{photo.size[0]}x{photo.size[1]}", photo.sha256]
        for k, photo in enumerate(photos)
    ]
    return page.section(
        "Where the numbers come from",
        page.table(["", ""], known, text=2),
        page.table(["photo", "", "px", "SHA-256"], files, text=4),
    )
