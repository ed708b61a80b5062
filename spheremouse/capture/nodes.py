"""The cameras of this computer: their nodes, lasting names and rights; and findings about paths of recordings."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from spheremouse.files.access import access_problem, account
from spheremouse.finding import Finding, absent, ok, warning, wrong

VIDEO_CLASS = Path("/sys/class/video4linux")
_DEV, _BY_ID = Path("/dev"), Path("/dev/v4l/by-id")


@dataclass(frozen=True, slots=True)
class Node:
    """A camera, by the first of its nodes: the others carry no pictures."""

    path: Path
    name: str
    lasting: Path | None  # the name below /dev/v4l/by-id, which stays


def nodes(listed: Path = VIDEO_CLASS, devices: Path = _DEV, by_id: Path = _BY_ID) -> list[Node]:
    """Return the cameras of this computer, by number."""
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


def persistent_name(path: str) -> str | None:
    """Return the name of a camera that does not depend on the order of plugging in; None if it has none."""
    resolved = Path(path).resolve()
    lasting = next((n.lasting for n in nodes() if n.path.resolve() == resolved), None)
    return None if lasting is None or str(lasting) == path else str(lasting)


def cameras_here() -> str:
    """Return the cameras of this computer in words."""
    found = ", ".join(f"{n.path} ({n.name})" for n in nodes())
    return f"here: {found}" if found else "there is no camera here; plug it in"


def default_camera(found: list[Node] | None = None) -> str:
    """Return the source of the first camera, by its persistent name if the system has one, otherwise by its number."""
    if not sys.platform.startswith("linux"):
        return "opencv:0"
    lasting = [n.lasting for n in (nodes() if found is None else found) if n.lasting is not None]
    return f"v4l2:{lasting[0] if lasting else '/dev/video0'}"


def in_size(source: str, size: tuple[int, int] | None) -> str:
    """Return the source with `,width=W,height=H` for a `size` (W, H) px.

    It stays unchanged without a size, if it has a width already, and unless it begins with `v4l2:` or `opencv:`.
    """
    if size is None or source.partition(":")[0] not in ("v4l2", "opencv") or "width=" in source:
        return source
    return f"{source},width={size[0]},height={size[1]}"


def probe_node(node: Path, found: list[Node]) -> list[Finding]:
    """Return findings about a camera's node: whether it exists, keeps its name, and may be used by this account."""
    listed = next((n for n in found if n.path.resolve() == node.resolve()), None)
    if not os.path.exists(node):
        named = " or ".join(f"v4l2:{n.lasting or n.path}" for n in found)
        others = f", or name the one there is: {named}" if named else ""
        return [absent("camera", f"{node} does not exist", f"plug it in{others}")]
    camera = ok("camera", str(node))
    if listed is not None and listed.lasting is not None and node == listed.path:
        camera = warning(
            "camera",
            f"{node} is a number, which may go to another camera at the next start",
            f"use its permanent name: source: v4l2:{listed.lasting}",
        )
    problem = access_problem(node)
    access = (
        ok("camera access", f"{account()} may use {node}") if problem is None else absent("camera access", *problem)
    )
    return [camera, access]


def probe_path(path: Path) -> Finding:
    """Return whether a recording exists. A relative path may exist in another folder."""
    if path.exists():
        return ok("source", str(path))
    if path.is_absolute():
        return wrong("source", f"{path}: not there", "check the path")
    return absent("source", f"{path}: does not exist in this folder", "check the path")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
