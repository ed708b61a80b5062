"""`spheremouse tune`: search settings for which a recording is tracked better."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spheremouse.commands.options import Assignments, ConfigFile
from spheremouse.errors import ConfigurationError, format_count

if TYPE_CHECKING:
    from spheremouse.session.tune import Tuning

_UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}


def tune(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", show_default=False, help="Folder of a recording.")],
    budget: Annotated[
        str, typer.Option(metavar="TIME", help="Time of search and test together: 30s, 5min, 1h.")
    ] = "5min",
    trials: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="At most this number of trials, to repeat a search exactly.")
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the search.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="FILE", help="Also write the configuration.  [default: only print the new settings]"
        ),
    ] = None,
    config_file: ConfigFile = None,
    assignments: Assignments = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Search the sections so3, discs and loss of the settings for values that track a recording of a ball better.

    The search minimises a cost. With truth, that is the errors of attitude and angular velocity. Without truth, it is
    inconsistent innovations, unused discs and a rough angular velocity. The search uses the first half of the
    recording. If the cost of the second half is not significantly smaller, the command reports that and writes nothing.
    The command may exceed the budget by the time of one trial. It keeps time for the test on the second half, and for
    one run without each new setting. Ctrl-C ends the search and tests the best settings so far. The command needs the
    extra `tune`.
    """
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.commands.terminal import progress_bar
    from spheremouse.files import config
    from spheremouse.files.dataset.ball import open_dataset
    from spheremouse.files.safe_files import write_atomically
    from spheremouse.session.settings import Configuration
    from spheremouse.session.tune import changed, tune

    seconds = _seconds(budget)
    check_outputs([out], [recording, config_file], force=force)
    settings = config.in_force(config_file, assignments or (), Configuration)
    with progress_bar() as progress:
        task = progress.add_task("tuning", total=trials)

        def show(count: int, relative_cost: float) -> None:
            progress.update(task, completed=count, description=f"tuning: cost {100 * relative_cost:.0f} % of now")

        found = tune(open_dataset(recording), settings, seconds, trials, seed, show)
    print(format_count(found.trials, "trial"))
    if not found.better:
        print(f"nothing changed: {_reason(found)}")
        return
    for key, value in found.values.items():
        gain = found.gains.get(key)
        saved = "no time was left to test it alone" if gain is None else f"saves {100 * gain:.0f} % of the cost"
        print(f"{key}={config.to_yaml(value)}  {saved}")
    print(f"on the second half of the recording the cost is {100 * found.held_out.gain:.0f} % smaller")
    if out is not None:
        check_outputs([out], [], force=force)  # another search may have written it meanwhile
        write_atomically(out, config.dump(changed(settings, found.values), Configuration()))
        print(f"{out}: written")


def _reason(found: "Tuning") -> str:
    if not found.values:
        return "no trial was better than the present settings"
    return (
        "on the second half of the recording, the best settings change the cost by "
        f"{-100 * found.held_out.gain:+.1f} %, which is no significant gain"
    )


def _seconds(text: str) -> float:
    found: Any = re.fullmatch(r"(\d{1,6}(?:\.\d{1,3})?) ?(s|min|h|)", text.strip())
    if found is None or not float(found[1]) > 0.0:
        raise ConfigurationError(f"--budget {text}: is no time", "write for example 30s, 5min or 1h")
    return float(found[1]) * _UNITS[found[2]]
