"""The camera nodes of this computer: which there are, by which lasting name, and whether this account may use them."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from spheremouse.commands.doctor.access import account, groups, refusal
from spheremouse.commands.doctor.finding import Finding, ok, unchecked, warning, wrong

_SYS, _DEV, _BY_ID = Path("/sys/class/video4linux"), Path("/dev"), Path("/dev/v4l/by-id")


@dataclass(frozen=True, slots=True)
class Node:
    """A camera, by the first of its nodes: the others carry no pictures."""

    path: Path
    name: str
    lasting: Path | None  # the name that stays, whatever is plugged in before


def nodes(listed: Path = _SYS, devices: Path = _DEV, by_id: Path = _BY_ID) -> list[Node]:
    """Those there are, by number."""
    try:
        entries = sorted(listed.iterdir(), key=lambda p: (len(p.name), p.name))
    except OSError:
        return []
    links = {link.resolve(): link for link in sorted(by_id.iterdir())} if by_id.is_dir() else {}
    found = []
    for entry in entries:
        if entry.name.startswith("video") and _text(entry / "index") in ("", "0"):
            path = devices / entry.name
            found.append(Node(path, _text(entry / "name") or "unnamed", links.get(path.resolve())))
    return found


def first(found: list[Node]) -> str | None:
    """The source that the first camera would be."""
    return f"v4l2:{found[0].lasting or found[0].path}" if found else None


def present(found: list[Node], node: Path | None, live: bool) -> list[Finding]:
    """A line for all cameras; one for the name of the one in use."""
    if not found and not live:
        return [ok("cameras", "there is none, and this source needs none")]
    if not found and not sys.platform.startswith("linux"):
        return [unchecked("cameras", "this system does not list them by name")]
    if not found:
        return [
            wrong(
                "cameras",
                "there is no camera",
                "plug a webcam in (docs/camera.md: which one); `dmesg` says what became of it",
            )
        ]
    listed = "; ".join(f"{n.path} ({n.name}){f' = {n.lasting}' if n.lasting else ''}" for n in found)
    findings = [ok("cameras", listed, cameras=[str(n.lasting or n.path) for n in found])]
    if node is None:
        return findings
    here = next((n for n in found if n.path.resolve() == node.resolve()), None)
    if here is None and not os.path.exists(node):
        named = " or ".join(str(n.lasting or n.path) for n in found)
        return [
            *findings,
            wrong("camera", f"{node} is not there", f"plug it in, or name the one there is: v4l2:{named}"),
        ]
    if here is not None and here.lasting is not None and node == here.path:
        return [*findings, warning(
            "camera",
            f"{node} is a number, which may go to another camera at the next start",
            f"name it by what stays: source: v4l2:{here.lasting}",
        )]  # fmt: skip
    return [*findings, ok("camera", str(node))]


def permitted(node: Path) -> Finding:
    """Right of this account to open the camera."""
    said = refusal(node)
    if said is None:
        return ok("camera access", f"{account()} may use {node}", groups=groups())
    return wrong("camera access", said[0], said[1], groups=groups())


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
