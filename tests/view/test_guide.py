"""The guide in a browser, before a practice camera."""

import re

import guide_world
import pytest
from view_world import wait_for

PATIENCE = 300  # s of a step on a busy machine


@pytest.fixture
def world(browser, tmp_path):
    world = guide_world.Page(tmp_path)
    yield world
    world.end_page()


class Walk:
    """The panel of the guide."""

    def __init__(self, page):
        self._page, self._panel = page, page.locator("#panel-Guide")
        page.locator("#tab-Guide").click()

    def reach(self, step):
        """Wait until a step is the next one."""
        wait_for(
            step, lambda: self.problem() or self._panel.locator(".next", has_text=f"{step}:").is_visible(), PATIENCE
        )
        assert self.problem() == []

    def run(self, step):
        """Run the first command of a step."""
        self.reach(step)
        self._panel.locator(".next button", has_text="Run").first.press("Enter")

    def problem(self):
        """Return the error of the last command."""
        return self._panel.locator(".refused").all_inner_texts()

    def until(self, text):
        """Wait for a text in the panel."""
        self._panel.get_by_text(re.compile(text)).first.wait_for(timeout=1000 * PATIENCE)


def violations(page):
    """Return the findings of axe."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    response = axe.Axe().run(page, options={"resultTypes": ["violations"]}).response
    return [(v["id"], [node["html"] for node in v["nodes"]]) for v in response["violations"]]


@pytest.mark.slow
def test_the_walk_from_an_empty_folder_to_a_moving_pointer(browser, world):
    page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
    page.goto(world.owner_url)
    walk = Walk(page)

    page.locator("#look").press("Enter")
    walk.until(f"The camera is v4l2:{world.folder}/usb-practice-camera")
    walk.until("4 targets: CMY CYM MCY YMC")
    walk.until("sharp, edges")
    walk.until("the brightest of the picture is at")

    walk.run("folder")
    walk.run("print")
    walk.reach("photos of the board")
    assert page.evaluate("document.activeElement.id") == "look"  # focus is not lost with the button of the last step
    page.locator("#square").fill("86")
    walk.run("photos of the board")
    walk.until("Next: (tilt|show|come)")
    page.locator("#panel-Guide img").wait_for()
    assert violations(page) == []
    walk.run("camera.yaml")
    walk.reach("device.yaml")
    page.locator("#device").fill("targets: [")
    page.locator("#describe").press("Enter")
    walk.until("has mistakes")
    assert page.evaluate("document.activeElement.id") == "look"
    page.locator("#device").fill((world.folder / "practice" / "device.yaml").read_text())
    page.locator("#describe").press("Enter")
    walk.run("photos of the device")
    walk.until(r"view_00\d.png")
    assert page.evaluate("document.activeElement.id") == "stop"
    walk.run("rig.yaml")
    walk.run("axes")
    walk.until("1 of 3: roll the ball to the right")

    walk.run("service")
    page.get_by_text("tracking", exact=True).wait_for(timeout=1000 * PATIENCE)
    wait_for("a moving pointer", lambda: len(guide_world.moves(world.folder)) > 5)
    walk.until("sudo spheremouse service install")
    page.locator("#stop").press("Enter")
    page.get_by_text("offline", exact=True).wait_for()
    page.context.close()
