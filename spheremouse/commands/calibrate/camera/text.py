"""What `spheremouse calibrate camera` prints of a camera that it has calibrated."""

from rich.markup import escape
from rich.table import Table

from spheremouse.calibrate.camera.advice import advise
from spheremouse.calibrate.camera.calibrate import Calibrated
from spheremouse.calibrate.camera.report import held_out_rms, parameter_rows, view_rows
from spheremouse.commands.terminal import table_console


def camera_text(done: Calibrated) -> None:
    """Print parameters, views and advice."""
    console = table_console()
    table = Table(box=None, title_justify="left", title_style="")
    held = held_out_rms(done)
    table.title = (
        f"{int(done.found.used.sum())} views of {len(done.photos)} photos, {done.found.camera.width}x"
        f"{done.found.camera.height}: reprojection {done.found.rms:.3f} px RMS"
        + ("" if held is None else f", {held:.3f} px in views held out")
    )
    for name in ("", "value", "std. dev."):
        table.add_column(name, justify="left" if not name else "right")
    for row in parameter_rows(done):
        table.add_row(*row[:3])
    console.print(table)
    views = Table(box=None)
    for name in ("view", "rms, px", "held out, px", "tilt, °", "distance, m", ""):
        views.add_column(name, justify="left" if name in ("view", "") else "right")
    for row, used in view_rows(done):
        views.add_row(*map(escape, row), style=None if used else "red")
    console.print(views)
    for kind, text in advise(done):
        mark = {"good": "[green]✓[/]", "note": "[blue]i[/]", "warning": "[yellow]![/]"}[kind]
        console.print(f"{mark} {escape(text.replace('`', ''))}")
