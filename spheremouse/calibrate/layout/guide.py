"""A page to print for whoever puts the discs on the ball with a tape measure: directions in, one HTML file out.

Lengths on the page are mm along the surface. A pole mark P, a band of masking tape round the equator with its own mm
scale, and a tape pulled from P over the band: every disc has one place, and no two arcs to be crossed.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spheremouse.calibrate.layout.drawing import drawing, drawn_radius, sketch
from spheremouse.calibrate.layout.search import CLEAR, ENOUGH, Judgement, Trials, alike
from spheremouse.errors import ConfigurationError
from spheremouse.files.atomic import write_atomically
from spheremouse.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class Place:
    """Where one disc goes; all but numbers in mm along the surface."""

    number: int  # from 1, in the order of work
    band: int | None  # reading of the band that the tape runs over; None at the pole
    from_pole: int
    below_band: int  # negative above it, towards the pole
    checks: tuple[tuple[int, int], ...]  # number of a disc already there, and distance to it


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What inaccurate placement does to a layout: the worst of some random misplacements."""

    sd_mm: float  # mm to either side
    separability: float  # contradictions
    in_view: int  # discs


@dataclass(frozen=True, slots=True)
class Design:
    """A layout as it is on the tape, and what it is worth."""

    directions: Array  # (n, 3) unit vectors, ball: z to the pole mark, x to the band's zero
    radius: float  # m, of the ball
    disc_radius: float  # m, along the surface
    view_angle: float  # rad
    seed: int
    judgement: Judgement
    trials: Trials
    trial_sigma: float  # rad
    trial_missing: float
    accuracy: tuple[Accuracy, ...]
    tries: int  # misplaced layouts for each line of `accuracy`

    @property
    def bears_mm(self) -> float:
        """The largest standard deviation tried up to which every misplaced layout was clear; 0 for none."""
        bears = 0.0
        for a in self.accuracy:
            if a.separability < CLEAR or a.in_view < min(ENOUGH, self.judgement.in_view):
                break
            bears = a.sd_mm
        return bears


def tape_step(radius: float) -> int:
    """mm to which a tape is read: 5 on a large ball, 1 on one that a hand can hold."""
    return 5 if radius >= 0.3 else 1


def on_the_tape(directions: Array, radius: float) -> Array:
    """Directions, (n, 3), at the whole steps of the tape nearest to those given: from the pole, and along the band."""
    step = 1e-3 * tape_step(radius) / radius
    polar = np.rint(np.arccos(np.clip(directions[:, 2], -1.0, 1.0)) / step) * step
    azimuth = np.rint(np.arctan2(directions[:, 1], directions[:, 0]) / step) * step
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)


def places(directions: Array, radius: float) -> list[Place]:
    """What to measure for each disc, in the order of `directions`; each is checked by the two nearest before it."""
    step, mm = tape_step(radius), 1e3 * radius
    angle = np.arccos(np.clip(directions @ directions.T, -1.0, 1.0))

    def taped(length: float) -> int:
        return int(round(length / step) * step)

    found = []
    for k, (x, y, z) in enumerate(directions):
        polar = float(np.arccos(np.clip(z, -1.0, 1.0)))
        on_axis = np.hypot(x, y) * mm < 0.5 * step
        reading = (
            None if on_axis else taped(float(np.arctan2(y, x)) % (2.0 * np.pi) * mm) % max(taped(2 * np.pi * mm), 1)
        )
        nearest = np.argsort(angle[k, :k], kind="stable")[:2]
        checks = tuple((int(j) + 1, taped(float(angle[k, j]) * mm)) for j in nearest)
        found.append(Place(k + 1, reading, taped(polar * mm), taped((polar - 0.5 * np.pi) * mm), checks))
    return found


def write_guide(path: Path, design: Design) -> None:
    """Write the page; whole or not at all."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise ConfigurationError(f"{path.parent}: cannot be made: {e.strerror or e}") from None
    write_atomically(path, guide_text(design))


def guide_text(design: Design) -> str:
    """The page as HTML: steps, drawing, table. It needs no other file."""
    n, mm = len(design.directions), 1e3 * design.radius
    circumference = round(2.0 * np.pi * mm)
    step = tape_step(design.radius)
    quarter = round(0.25 * circumference / step) * step
    title = f"Where to put the {n} discs"
    ball = f"Ball {2 * mm:.0f} mm in diameter ({circumference} mm around) · discs {2e3 * design.disc_radius:.0f} mm"
    every = 500 if design.radius >= 0.3 else 50
    scale = "to scale"
    if drawn_radius(design.radius, design.disc_radius) != design.disc_radius:
        scale = "drawn larger than they are"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>{_STYLE}</style>
</head>
<body>
<section>
<header><h1>{title}</h1><p>{ball} · layout of seed {design.seed}</p></header>
<h2>How exact?</h2>
{_how_exact(design)}
<figure>{sketch()}
<figcaption>The tape runs from P straight over the band's reading. Discs of the lower half lie beyond the
band.</figcaption>
</figure>
<h2>You need</h2>
<ul>
<li>{n} discs, all alike, dull, and dark on a light ball or light on a dark one</li>
<li>a soft tape measure of {np.ceil(circumference / 1000):.0f} m that lies flat on the ball</li>
<li>masking tape for {circumference / 1000:.1f} m, 10 to 20 mm wide, and a pencil</li>
<li>a second pair of hands for the lower half</li>
</ul>
<h2>Steps</h2>
<ol>
<li>Measure once around the ball. It should be {circumference} mm. If yours differs by more than
{circumference // 50} mm,
print a page of its own: <code>spheremouse layout --discs {n} --radius R</code>, R the length around in m, divided by
6.283.</li>
<li>Put disc 1 where you like. Its middle is the pole P, from which the tape will start.</li>
<li>Mark some twelve points all around, each {quarter} mm from P. Lay the masking tape with its edge along them: this
is the
band. Begin and end it at the same place.</li>
<li>Write <b>0</b> where you like on the band, and go on to the right (P is up) with a mark every {every} mm. You
come back
to 0 at {circumference}; some mm more or less do not matter.</li>
<li>For each line of the table, in its order: hold the tape at P, lead it straight over the band at the reading
<i>band</i>, and put the middle of the disc at <i>from P</i>. <i>From band</i> says the same from the band.</li>
<li>Measure the checks. More than {10 * step} mm off: you have read another line; put the disc right. Less: leave
it.</li>
<li>Compare with the drawing, above all left and right. Take the band off. Done: P and 0 are never needed again.</li>
</ol>
</section>
<section class="page">
<h2>Drawing</h2>
<p>The ball opened at the band's 0, seen from outside: the half around P above, the lower half below. Rings are the
distance from P; readings of the band run around the rim. Discs are {scale}.</p>
{drawing(design.directions, design.radius, design.disc_radius)}
</section>
<section class="page">
<h2>Table</h2>
<p>All lengths in mm along the surface, to {step} mm. <i>band</i>: reading that the tape runs over. <i>from band</i>:
↑ towards P,
↓ away from it. <i>check</i>: distance to discs that are there already.</p>
{_table(places(design.directions, design.radius))}
<h2>What this layout is worth</h2>
{_worth(design)}
</section>
</body>
</html>
"""


def _how_exact(design: Design) -> str:
    bears = design.bears_mm
    tried = f"{len(design.accuracy)} degrees of carelessness"
    if bears > 0.0:
        least = min(a.separability for a in design.accuracy if a.sd_mm <= bears)
        much = (
            f"Even where every disc was off by {_short(bears)} mm at random (standard deviation to either side"
            f"{', the most that was tried' if bears == design.accuracy[-1].sd_mm else ''}), "
            f"at least {least:.1f} discs told any view from all others."
        )
    else:
        much = f"Of {tried} that were tried, none kept all views apart: more discs would."
    return (
        "<p class='box'><b>Not at all, for tracking:</b> the tracker measures where the discs are as the ball turns. "
        "By eye is fine. What counts is that no two sides of the ball look alike. "
        f"{much} So do not correct what is a finger's width off; do correct a disc in a wrong place altogether. "
        "And do not make it tidier: a regular pattern is the one thing to avoid.</p>"
    )


def _short(mm: float) -> str:
    """A length in whole mm, or in tenths where it is short."""
    return f"{mm:.0f}" if mm >= 10.0 else f"{mm:.1f}"


def _worth(design: Design) -> str:
    j, t = design.judgement, design.trials
    mm = 1e3 * design.radius
    rows = "".join(
        f"<tr><td>{_short(a.sd_mm)}</td><td>{a.separability:.1f}</td><td>{a.in_view}</td></tr>" for a in design.accuracy
    )
    return f"""<table class="small"><caption>Put up inaccurately: the worst of {design.tries} random tries</caption>
<thead><tr><th>off by, mm<br>(sd each way)</th><th>discs that tell<br>the worst view</th><th>least<br>in
view</th></tr></thead>
<tbody>{rows}</tbody></table>
<ul>
<li>At least <b>{j.in_view}</b> discs are in view from anywhere (within {np.degrees(design.view_angle):.0f}° of the
direction to the camera).</li>
<li>Nearest neighbours are {j.apart * mm:.0f} mm apart (discs {j.closest[0] + 1} and {j.closest[1] + 1}).</li>
<li>Any view is told from all others by at least <b>{j.separability:.1f}</b> discs, half of all views by
{np.median(j.contradictions):.1f} or more. Places within {alike(len(design.directions)) * mm:.0f} mm pass for alike
here, though a
camera sees ten times better.</li>
<li>Of random attitudes with directions good to {np.degrees(design.trial_sigma):.2g}° and
{100 * design.trial_missing:.0f} % of the discs hidden,
{100 * t.found:.1f} % were recognised from one picture, {100 * t.refused:.1f} % left open, {100 * t.wrong:.1f} %
mistaken.</li>
</ul>"""


def _table(all_places: list[Place]) -> str:
    rows = []
    for p in all_places:
        band = "–" if p.band is None else str(p.band)
        side = "on it" if p.below_band == 0 else f"{'↓' if p.below_band > 0 else '↑'} {abs(p.below_band)}"
        checks = [f"<td>to {k}:</td><td>{length}</td>" for k, length in p.checks]
        checks += ["<td></td><td></td>"] * (2 - len(checks))
        where = (
            "<td colspan='3' class='pole'>P itself</td>"
            if p.from_pole == 0
            else (f"<td>{band}</td><td class='strong'>{p.from_pole}</td><td>{side}</td>")
        )
        rows.append(f"<tr><td class='tick'>☐</td><td class='strong'>{p.number}</td>{where}{''.join(checks)}</tr>")
    return (
        "<table class='places'><thead><tr><th></th><th>disc</th><th>band</th><th>from P</th><th>from band</th>"
        "<th colspan='2'>check</th><th colspan='2'>check</th></tr></thead><tbody>" + "".join(rows) + "</tbody></table>"
    )


_STYLE = """
@page { size: A4; margin: 14mm 15mm; }
* { box-sizing: border-box; }
body { font: 10.5pt/1.42 "Helvetica Neue", Arial, "Liberation Sans", "DejaVu Sans", sans-serif; color: #000;
  background: #fff; max-width: 180mm; margin: 0 auto; }
header { border-bottom: 1.2pt solid #000; margin-bottom: 4mm; }
h1 { font-size: 22pt; line-height: 1.15; margin: 0; }
header p { margin: 1mm 0 2mm; }
h2 { font-size: 12.5pt; margin: 5mm 0 1.5mm; }
p { margin: 0 0 2mm; }
ul, ol { margin: 0; padding-left: 6mm; }
li { margin-bottom: 1.3mm; }
code { font-size: 9.5pt; }
.box { border: 1pt solid #000; padding: 2.5mm 3mm; }
figure { float: right; width: 72mm; margin: 0 0 3mm 6mm; }
figcaption { font-size: 9pt; }
svg { display: block; width: 100%; height: auto; }
svg.drawing { width: 180mm; max-width: 100%; }
svg text { font-family: inherit; fill: #000; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
thead { display: table-header-group; }
tr { break-inside: avoid; }
th { text-align: right; font-weight: normal; font-style: italic; border-bottom: 0.8pt solid #000;
  padding: 0.6mm 2.5mm; }
td { text-align: right; padding: 0.55mm 2.5mm; border-bottom: 0.25pt solid #aaa; }
.places { width: 100%; font-size: 10pt; line-height: 1.25; }
.places tr:nth-child(5n) td { border-bottom: 0.6pt solid #000; }
.places th[colspan] { text-align: center; }
.strong { font-weight: bold; }
.tick { font-size: 12pt; line-height: 1; text-align: center;
  font-family: "DejaVu Sans", "Segoe UI Symbol", sans-serif; }
.pole { text-align: center; }
.small { font-size: 9.5pt; float: right; width: 72mm; margin-left: 8mm; }
.small caption { text-align: left; font-size: 9.5pt; padding-bottom: 1mm; }
@media screen { body { padding: 10mm 5mm; } .page { margin-top: 12mm; border-top: 0.5pt dashed #999; } }
@media print { .page { break-before: page; } .page h2:first-child { margin-top: 0; } }
"""
