"""`spheremouse service`: install, remove and examine the service that starts with the computer."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.service import systemd as service
from spheremouse.commands.service.systemd import UNIT, USER, VIEW_UNIT, Place
from spheremouse.errors import ServiceError, printable
from spheremouse.files.access import service_files

app = typer.Typer(no_args_is_help=True, help="Start with the computer: install, uninstall, status.")

_ROOT = Path("/")
_User = Annotated[bool, typer.Option("--user", help="The service of your own account, in place of the system's.")]
_DryRun = Annotated[bool, typer.Option("--dry-run", help="Print the changes and make none.")]
_Root = Annotated[
    Path,
    typer.Option("--root", metavar="DIR", help="Place the files below DIR and start nothing, for packages and images."),
]


@app.command(epilog="Example: sudo spheremouse service install")
def install(
    user: _User = False,
    dry_run: _DryRun = False,
    root: _Root = _ROOT,
    start: Annotated[bool, typer.Option("--start/--no-start", help="Start or restart the service.")] = True,
    allow: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS",
            help="Network address, or network, of outputs and metrics; repeat it. The list replaces the last one. "
            "[default: none but this machine]",
        ),
    ] = None,
) -> None:
    """Place the unit, its user, udev rules and a first configuration; safe to repeat.

    If a file differs, the command replaces it. It never changes an existing configuration.
    """
    place = _checked_place(root, user)
    if user and allow:
        raise ServiceError("--allow: the service of your own account has no filter of addresses", "leave --allow out")
    program, trouble = service.executable(place)
    if trouble and not dry_run:
        raise ServiceError(trouble)
    actions = list(service.install(place, program, allow or ()))
    if dry_run:
        typer.echo("".join(f"would {action}\n" for action in actions), nl=False)
    else:
        _refuse_without_rights(place, actions, "install")
        for line in service.carry_out(actions, umask=0o077 if user else 0o022):
            typer.echo(line)
    if not actions:
        typer.echo("all files are in place")
    if trouble:
        raise ServiceError(f"it would be refused: {trouble}")
    if place.root != _ROOT:
        return
    commands = _activation(place, start)
    if dry_run or not _systemd_runs(place):
        _by_hand(place, commands, dry_run)
    elif not _run(commands):
        raise typer.Exit(1)
    _print_next_steps(place)


@app.command(epilog="Example: sudo spheremouse service uninstall --purge")
def uninstall(
    user: _User = False,
    dry_run: _DryRun = False,
    root: _Root = _ROOT,
    purge: Annotated[
        bool, typer.Option("--purge", help="Remove configuration, calibration, map and recordings, too.")
    ] = False,
) -> None:
    """Stop the service and remove its files. Configuration, calibration and recordings stay, unless --purge."""
    place = _checked_place(root, user)
    actions = list(service.uninstall(place, purge))
    live = place.root == _ROOT and _systemd_runs(place)
    if dry_run:
        typer.echo("\n".join(f"would {action}" for action in actions) or "there is no service")
        return
    _refuse_without_rights(place, actions, "uninstall")
    if live and actions:
        _run([[*_systemctl(place), "stop", UNIT, VIEW_UNIT]], quiet=True)
    for line in service.carry_out(actions):
        typer.echo(line)
    service.tidy(place)
    if live and actions:
        after = [[*_systemctl(place), "daemon-reload"], [*_systemctl(place), "reset-failed", UNIT, VIEW_UNIT]]
        after += [] if user else [["udevadm", "control", "--reload"]]
        _run(after, quiet=True)
    stays = service.left(place)
    if not user and place.root == _ROOT and not stays:
        _run([["userdel", USER], ["groupdel", USER]], quiet=True)  # userdel leaves a group with members
    if stays:
        suffix = "" if user else f", and the user {USER}"
        typer.echo(f"kept{suffix}; --purge removes it, too:")
        for path in stays:
            typer.echo(f"  {printable(path)}")
    typer.echo("the service is gone" if actions else "there was no service")


@app.command(epilog="Example: spheremouse service status")
def status(user: _User = False, root: _Root = _ROOT) -> None:
    """Check the files, and whether the service runs; exit code 1 if something is missing."""
    from rich.console import Console

    from spheremouse.commands.findings import Section, show
    from spheremouse.commands.service.check import check_files, check_state, check_user
    from spheremouse.finding import Verdict

    place = _checked_place(root, user)
    findings = [check_files(place)]
    if place.root == _ROOT:
        findings += [check_state(place), *([] if user else [check_user(node=None)])]
    show(Section("service", tuple(findings)), Console(highlight=False, soft_wrap=False))
    if any(f.verdict in (Verdict.WARNING, Verdict.WRONG) for f in findings):
        raise typer.Exit(1)


def _checked_place(root: Path, user: bool) -> Place:
    """Return where to put the files. Raises ServiceError where this user cannot put them."""
    if sys.platform != "linux":
        raise ServiceError("service: needs Linux with systemd; elsewhere have the system start `spheremouse run`")
    if user and os.geteuid() == 0 and os.environ.get("SUDO_USER"):
        raise ServiceError("--user is for your own account: repeat it without sudo")
    if not root.is_dir():
        raise ServiceError(f"--root: {root} is no directory; make it first")
    place = Place(root.resolve(), user)
    service.refuse_unsafe(place)
    return place


def _refuse_without_rights(place: Place, actions: list[service.FileAction], command: str) -> None:
    if actions and not service.may(place):
        given = sys.argv[sys.argv.index(command) + 1 :] if {"service", command} <= set(sys.argv) else []
        words = [shutil.which("spheremouse") or service.executable(place)[0], "service", command, *given]
        again = ("" if place.user else "sudo ") + shlex.join(words)
        folder = place.inside(place.unit.parent.parent)
        raise ServiceError(f"service: this account may not write below {folder}; repeat it with: {again}")


def _activation(place: Place, start: bool) -> list[list[str]]:
    """Return the commands that make systemd, udev and the kernel use the installed files."""
    listed = (service_files() / "systemd" / "modules-load.conf").read_text(encoding="utf-8")
    commands = [] if place.user else [
        ["systemd-sysusers", "/etc/sysusers.d/spheremouse.conf"],
        ["systemd-tmpfiles", "--create", "/etc/tmpfiles.d/spheremouse.conf"],
        ["modprobe", "-a", *re.findall(r"^\w+$", listed, re.M)],
        ["udevadm", "control", "--reload"],
        ["udevadm", "trigger", *(f"--subsystem-match={s}" for s in ("misc", "video4linux", "tty"))],
    ]  # fmt: skip
    commands.append([*_systemctl(place), "daemon-reload"])
    if start:
        calibrated = (place.configuration / "rig.yaml").exists()
        commands.append([*_systemctl(place), "restart", "--no-block", *([UNIT] if calibrated else []), VIEW_UNIT])
    return commands


def _systemctl(place: Place) -> list[str]:
    return ["systemctl", "--user"] if place.user else ["systemctl"]


def _systemd_runs(place: Place) -> bool:
    """Return True if systemd runs here, as in sd_booted(3), or the user's own systemd."""
    if place.user:
        return (Path(os.environ.get("XDG_RUNTIME_DIR") or "/nowhere") / "systemd").is_dir()
    return Path("/run/systemd/system").is_dir()


def _run(commands: list[list[str]], quiet: bool = False) -> bool:
    """Run the commands and print those that fail. Return whether all but modprobe and udevadm succeeded."""
    well = True
    for command in commands:
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
            lines = done.stderr.strip().splitlines() or [f"exit {done.returncode}"]
            reason = lines[-1] if done.returncode else ""
        except (OSError, subprocess.TimeoutExpired) as e:
            reason = str(e)
        if reason and not quiet:
            typer.echo(f"failed: {shlex.join(command)}: {reason}")
            well &= command[0] in ("modprobe", "udevadm")
    return well


def _by_hand(place: Place, commands: list[list[str]], dry_run: bool) -> None:
    if dry_run:
        typer.echo("would then run:")
    else:
        typer.echo("systemd does not run here; the files take effect at the next start, or after")
    sudo = "" if place.user or os.geteuid() == 0 else "sudo "
    for command in commands:
        typer.echo(f"  {sudo}{shlex.join(command)}")


def _print_next_steps(place: Place) -> None:
    """Print the next commands after the installation: to calibrate and start, or to look at the status."""
    rig, user = place.configuration / "rig.yaml", " --user" if place.user else ""
    if not rig.exists():
        sudo = "" if place.user else "sudo "
        typer.echo(f"next: calibrate (`spheremouse calibrate next`), then: {sudo}cp CABINET/rig.yaml {rig}")
        start = f"{sudo}systemctl{user} start {UNIT}"
        typer.echo(f"name the camera in {place.configuration / 'config.yaml'}, then: {start}")
    else:
        typer.echo(f"next: spheremouse ctl status; its log: journalctl{user} -u {UNIT}")
    if place.user and not os.access("/dev/uinput", os.W_OK):
        typer.echo("to move this computer's pointer (uinput), your account needs rights from root: see docs/install.md")
