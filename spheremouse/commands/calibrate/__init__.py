"""The commands of `spheremouse calibrate`."""

import typer

from spheremouse.commands.calibrate import camera, device, folder, photos, practice, rolling, tie
from spheremouse.commands.calibrate import print as prints

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Turn photos, or a minute of rolling, into a rig file with covariances.",
)

app.command("print", epilog=prints.EXAMPLE)(prints.print_)
app.command(epilog=folder.INIT_EXAMPLE)(folder.init)
app.command(epilog=photos.EXAMPLE)(photos.photos)
app.command(epilog=camera.EXAMPLE)(camera.camera)
app.command(epilog=device.EXAMPLE)(device.device)
app.command("next", epilog=folder.NEXT_EXAMPLE)(folder.next_)
app.command(epilog=practice.EXAMPLE)(practice.practice)
app.command(epilog=rolling.EXAMPLE)(rolling.rolling)
app.command(epilog=tie.EXAMPLE)(tie.tie)
