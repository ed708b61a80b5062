"""Setup of a run of the ball in its frame: rig, map, and the source, which may bring both."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from spheremouse.ball.rig import Rig
from spheremouse.capture import Source, open_source
from spheremouse.session import messages
from spheremouse.session.ball.follower import BallFollower, outputs_of
from spheremouse.session.ball.map_keeper import MapKeeper
from spheremouse.session.cameras import is_camera
from spheremouse.session.follower import MAP, Do
from spheremouse.session.offline import initialise, make_ready
from spheremouse.session.plan import Plan, Request, without_map
from spheremouse.tracker import Frame


@dataclass(frozen=True, slots=True)
class BallSetup:
    """A source that is no camera, where there is one."""

    source: Source | None = None

    @property
    def rig(self) -> Rig | None:
        """The device as the source knows it."""
        return None if self.source is None else self.source.rig

    def planned(self, request: Request, plan: Plan) -> Plan:
        """Drop the map for a device that the source brings, unless one was requested."""
        own = self.rig is not None and not is_camera(plan.source)
        return without_map(plan) if own and request.map is None and plan.configuration.map is None else plan

    def open(self, plan: Plan) -> Source:
        """A recording or the simulation, held to its stamps."""
        return open_source(plan.source, realtime=True)

    def make_ready(self, plan: Plan, tell: Callable[[str], None] | None = None) -> None:
        """Compile the filter and the detector of the plan."""
        make_ready(plan.configuration, tell)

    def follower(self, plan: Plan, say: Callable[[str], None], do: Do) -> BallFollower:
        """Raises ConfigurationError without a rig, or with a map that cannot be kept; PoseError without targets."""
        rig = plan.device(self.rig)
        keeper = None
        if plan.map_path is not None:
            keeper = MapKeeper(plan.map_path, rig, say, elsewhere=partial(do, MAP))
        return BallFollower(rig, plan.configuration, keeper, say, do, self.rig, outputs_of(plan))

    def begin(self, frames: Iterator[Frame], follower: BallFollower) -> Iterator[Frame]:
        """The camera's pose from the first views that show enough targets; PoseError where none do."""
        device, settings, said = follower.rig, follower.settings, list[str]()
        start = initialise(frames, device, settings, report=said.append)
        follower.untracked = start.passed
        for passed_over in said:
            follower.say(f"views passed over: {passed_over}")
        if start.resection is not None:
            follower.stands(start.pose, messages.standing(start.resection, device), start.resection)
        if device.scale_free:
            scale = settings.motion.scale(None)
            follower.say(f"the rig's scale is free: {scale:g} counts per radian (motion.counts_per_radian)")
        return start.frames
