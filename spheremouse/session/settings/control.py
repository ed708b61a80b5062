"""Settings of the control socket and of the metrics."""

from dataclasses import dataclass

from spheremouse.settings import param


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """The control socket, by which `spheremouse ctl` reaches the daemon. Read at the start only."""

    socket: str | None = param(
        None, "-", "path of the socket, at most 107 bytes; null puts control.sock into the runtime directory"
    )
    group: str | None = param(
        None,
        "-",
        "group whose members may use the socket and so steer the pointer (mode 0660); null allows root and the "
        "daemon's own user (0600)",
    )
    # Not a setting: connections of each user at a time. A person, a tray and a monitor need one each.
    clients: int = 16


@dataclass(frozen=True, slots=True)
class MetricsSettings:
    """Metrics for Prometheus over HTTP. Read at the start only."""

    port: int | None = param(None, "-", "TCP port; null opens none", ge=1, le=65535)
    address: str = param(
        "127.0.0.1",
        "-",
        "IP address of the port; the default serves this machine alone. Another one serves the network without a "
        "password",
    )
