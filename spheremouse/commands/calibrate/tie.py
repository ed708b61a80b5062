"""`spheremouse calibrate tie`: the rig of a second camera in the axes of the first."""

import sys
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.calibrate.outputs import check_outputs, note
from spheremouse.commands.options import Force
from spheremouse.errors import ConfigurationError

if TYPE_CHECKING:
    from spheremouse.ball.rig import Rig
    from spheremouse.calibrate.tie import AttitudeTrack
    from spheremouse.session.run_config import RunConfig

_LIVE_SECONDS = 60.0
_MAX_LAG_S = 0.002  # s; a hand turns the ball by half a degree in it


def tie(
    source: Annotated[
        list[str], typer.Option(metavar="KIND:ARG", help="Sources of the two cameras, as `run --source` takes them.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The rig file of the second camera to write.")],
    rig: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="Their rigs.  [default: the recordings' own]")
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="Configuration file, for the section `camera`.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", min=5.0, help="Use the first S seconds.  [default: all; live: 60]")
    ] = None,
    force: Force = False,
) -> None:
    """Turn the rig of a second camera into the axes of the first, by the motion of the ball that both see.

    Roll the ball in all directions while it runs. Each camera tracks it alone. The difference of the two tracks gives
    the rotation between their axes, with its covariance. Two rigs with the same targets need no tie.
    """
    import numpy as np

    from spheremouse import __version__
    from spheremouse.calibrate.tie import tie as estimate
    from spheremouse.calibrate.tie import tied
    from spheremouse.commands.options import one_or_all, settings_given
    from spheremouse.files.rig import save_rig
    from spheremouse.geometry.rotation import log
    from spheremouse.session.cameras import is_camera
    from spheremouse.session.run_config import CommandLineOverrides, check_kinds, read_run_config

    if len(source) != 2:
        raise ConfigurationError(f"--source: give two cameras, here are {len(source)}")
    own = ("source=null", "rig=null", "camera_file=null", "map=null", "tracker=so3")
    given = settings_given(None, config, {"source": source, "output": "null", "rig": one_or_all(rig)})
    plan = read_run_config(CommandLineOverrides(config, (*own, *given), no_map=True))
    check_kinds(plan)
    check_outputs([out], [each.rig_path for each in plan.cameras], force=force)
    live = is_camera(plan.source)
    length = seconds or (_LIVE_SECONDS if live else float("inf"))
    if live:
        print(f"roll the ball in all directions for {length:g} s", file=sys.stderr, flush=True)
    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda each: _track(each, length), plan.cameras)
    found = estimate(first[0], second[0])
    provenance = {
        "made_by": "spheremouse calibrate tie",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "version": __version__,
        "sources": [each.source for each in plan.cameras],
    }
    save_rig(out, tied(second[1], found), provenance)
    sigma = ", ".join(f"{np.degrees(s):.3f}" for s in np.sqrt(np.diag(found.covariance)))
    angle = np.degrees(np.linalg.norm(log(found.rotation)))
    fit = f"{found.frames} frames fit to {np.degrees(found.rms):.3f}°"
    typer.echo(f"{out}: written; the axes differ by {angle:.2f}°, one standard deviation {sigma}°; {fit}")
    if abs(found.lag) > _MAX_LAG_S:
        note(
            f"the stamps of the second camera are {1e3 * found.lag:.1f} ms late: use two cameras of one model and mode"
        )


def _track(plan: "RunConfig", seconds: float) -> tuple["AttitudeTrack", "Rig"]:
    """Track the ball by the camera of a plan with one, and return what it saw, and its rig."""
    import numpy as np

    from spheremouse.ball.build import build
    from spheremouse.calibrate.tie import AttitudeTrack
    from spheremouse.capture import section
    from spheremouse.session.cameras import looked_through
    from spheremouse.session.offline import initialise, track
    from spheremouse.tracker import Status

    settings = plan.configuration
    with looked_through(plan.source, settings.camera) as stream:
        rig = plan.device(stream.rig)
        start = initialise(section(iter(stream), 0.0, seconds), rig, settings)
        epochs = track(start.frames, build(rig, start.pose, settings))
        seen = [e.estimate for e in epochs if e.estimate.status is Status.TRACKING and e.estimate.confirmed]
    attitudes = np.array([each.rotation for each in seen]).reshape(-1, 3, 3)
    rates = np.array([each.rate[:3] for each in seen]).reshape(-1, 3)
    return AttitudeTrack(np.array([each.stamp for each in seen]), attitudes, rates), rig
