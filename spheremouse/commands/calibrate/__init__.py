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

_EXAMPLES = {  # a command, and the options of its example
    "print": (prints.print_, "--paper letter --only boards --square 20mm"),
    "init": (folder.init, "cabinet"),
    "photos": (photos.photos, "cabinet --for camera --source v4l2:/dev/video0"),
    "camera": (camera.camera, camera.EXAMPLE),
    "device": (device.device, "device/ --device device.yaml --camera camera.yaml --out rig.yaml"),
    "next": (folder.next_, "cabinet"),
    "practice": (practice.practice, "trial --photos 8 --seed 1"),
    "rolling": (rolling.rolling, "--source video:roll.mkv --camera camera.yaml --device device.yaml"),
    "tie": (tie.tie, "--source v4l2:0 --rig a.yaml --source v4l2:2 --rig b.yaml --out tied.yaml"),
}
for name, (command, options) in _EXAMPLES.items():
    app.command(name, epilog=f"Example: spheremouse calibrate {name} {options}")(command)
