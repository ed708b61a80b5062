"""`spheremouse calibrate practice`: a folder of simulated calibration photos and a film, with their truth."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.options import with_fields
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import CalibrationError, format_count
from spheremouse.simulate.ball.options import StillsOptions

_PARTS = ("board", "board.yaml", "device", "device.yaml", "film", "truth.json")


@with_fields()
def practice(
    folder: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the photos; made, or empty.")],
    *,
    like: Annotated[
        Path | None,
        typer.Option(metavar="DATASET", help="Photograph this dataset's device: ball, discs and targets as there."),
    ] = None,
    options: StillsOptions,
    jpeg: Annotated[int, typer.Option(metavar="Q", min=50, max=100, help="Quality of the JPEG files.")] = 95,
    filmed: Annotated[bool, typer.Option("--film/--no-film", help="With the film.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Replace a practice set that is there.")] = False,
) -> None:
    """Photograph a simulated device and board, to try calibration without a cabinet.

    Six photos are from front, left, right, high, low and turned by 90 degrees; further ones lie between and beside
    them. A film from the first place shows three gestures, for `spheremouse axes` and `spheremouse run`. At the end
    `calibrate next` compares your calibration with the truth.
    """
    from spheremouse.calibrate.guide.folder import FILM, camera_command, device_command, next_command
    from spheremouse.commands.calibrate.practice.write import device_of, film_of, write_stills
    from spheremouse.files.dataset.write import new_folder
    from spheremouse.simulate.ball.stills import prepare_stills
    from spheremouse.simulate.to_dataset import write_simulation

    if like is not None and options.discs is not None:
        raise CalibrationError(
            f"--discs {options.discs}: the discs are those of --like {like}; leave one of the two out"
        )
    if options.photos + options.boards == 0:
        raise CalibrationError("--photos 0 --boards 0: nothing to photograph; ask for one or more of a kind")
    if options.focal is not None and not 10.0 <= options.focal <= 100_000.0:
        raise CalibrationError(f"--focal {options.focal:g}: must be from 10 to 100000 px")
    stills = prepare_stills(options, None if like is None else device_of(like))
    film = film_of(stills) if options.photos and filmed else None
    with (
        new_folder(folder.absolute(), partial(_refuse, replace=force), CalibrationError) as made,
        progress_bar() as bar,
    ):
        task = bar.add_task(f"photographing into {folder}", total=options.photos + options.boards)
        for _ in write_stills(made, stills, jpeg):
            bar.advance(task)
        if film is not None:
            task = bar.add_task(f"filming into {folder}", total=film.frames)
            for _ in write_simulation(made / FILM, film):
                bar.advance(task)
    what = "a practice device" if like is None else f"the device of {like}"
    print(
        f"{folder}: {format_count(options.photos, 'photo')} of {what}, {options.boards} of the board, device.yaml, "
        "truth.json" + ("" if film is None else f", a {FILM} of three gestures")
    )
    print(f"next: {camera_command(folder)}")
    print(f"then: {device_command(folder)}")
    print(f"the next step, at any time: {next_command(folder)}")


def _refuse(path: Path, replace: bool) -> None:
    from spheremouse.files.dataset.write import refuse_to_overwrite

    refuse_to_overwrite(path, replace=replace, parts=_PARTS, what="a practice set", error=CalibrationError)
    if path.is_dir() and any(path.iterdir()) and not (path / "truth.json").is_file():
        raise CalibrationError(f"{path}: holds no truth.json, so these are real photos; they will not be replaced")
