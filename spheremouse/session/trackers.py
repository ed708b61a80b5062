"""Choose the tracker of a plan."""

from spheremouse.capture import open_source
from spheremouse.session.ball.setup import BallSetup
from spheremouse.session.cameras import is_camera
from spheremouse.session.follower import Setup
from spheremouse.session.plan import Plan
from spheremouse.session.wand.setup import WandSetup, wand_setup


def setup(plan: Plan, realtime: bool = False) -> Setup:
    """Return the setup of a plan. It opens a recording; `realtime` plays it at its own pace."""
    camera = is_camera(plan.source)
    if plan.configuration.tracker == "wand":
        return WandSetup() if camera else wand_setup(plan.source, realtime)
    return BallSetup() if camera else BallSetup(open_source(plan.source, realtime=realtime))
