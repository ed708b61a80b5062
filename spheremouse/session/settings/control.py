"""What may be configured of the control socket and of the metrics."""

from dataclasses import dataclass

from spheremouse.settings import param


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """The control socket: where `spheremouse ctl` reaches the daemon. Read at the start only."""

    socket: str | None = param(
        None, "-", "path of the socket, at most 107 bytes; null puts control.sock into the runtime directory"
    )
    group: str | None = param(
        None,
        "-",
        "members of this group may use the socket too (mode 0660); null leaves it to the daemon's own user and root "
        "(0600), since whoever may use it steers the pointer",
    )
    clients: int = param(
        16, "-", "how many may be connected at once; a person needs one, a tray and a monitor one each", ge=1, le=256
    )


@dataclass(frozen=True, slots=True)
class MetricsSettings:
    """Figures for Prometheus over HTTP, for who watches many cabinets. Read at the start only."""

    port: int | None = param(
        None, "-", "TCP port; null opens none, since most cabinets are watched by nobody", ge=1, le=65535
    )
    address: str = param(
        "127.0.0.1",
        "-",
        "IP address to listen at; the default lets only this machine ask, another one lets the network read, for "
        "there is no password",
    )
