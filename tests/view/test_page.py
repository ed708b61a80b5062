"""The page in a browser, on a service that tracks a film: what it shows, to whom, and what a lost connection does."""

import io
import signal
import time

import numpy as np
import pytest
from page_panels import choose, pixels
from PIL import Image
from view_world import Server, wait_for

PANELS = ("Tune", "Expert", "Log", "Draw", "Recordings", "Outputs", "Doctor", "Calibration", "Guide")
SIZES = {"desktop": (1280, 800), "phone": (390, 844)}


def test_state_and_reason_are_in_words_and_follow_the_service(page, service):
    wait_for("a reason", lambda: page.locator("#reason").inner_text())
    assert "sends no motion" in page.locator("#advice").inner_text()  # the output is null
    choose(page, "Outputs")
    page.locator("#panel-Outputs").get_by_role("rowheader", name="null").wait_for()
    service.ask("pause")
    page.get_by_text("paused", exact=True).wait_for()
    assert "Resume" in page.locator("#advice").inner_text()
    service.ask("resume")
    page.get_by_text("tracking", exact=True).wait_for()


def test_the_picture_moves_where_the_ball_is(page):
    page.get_by_role("checkbox", name="contours").wait_for()
    first = pixels(page)
    wait_for("another picture", lambda: np.abs(pixels(page) - first).max() > 60)


@pytest.mark.slow
def test_a_layer_can_be_switched_off(page):
    green = (94, 224, 110)  # of the targets

    def painted():
        picture = Image.open(io.BytesIO(page.locator("#picture").screenshot())).convert("RGB")
        return np.sum(np.abs(np.asarray(picture, dtype=int) - green).max(axis=2) < 25)

    wait_for("the targets", lambda: painted() > 50)
    page.get_by_role("checkbox", name="targets").uncheck()
    wait_for("no targets", lambda: painted() < 10)


@pytest.mark.slow
def test_the_view_in_space_turns_by_keys(page):
    space = page.locator("#space")
    page.get_by_role("button", name="Front").click()
    front = space.screenshot()
    space.focus()
    for _ in range(5):
        page.keyboard.press("ArrowLeft")
    assert space.screenshot() != front


def test_a_sentence_begins_with_a_capital_letter_and_a_path_or_device_stays_as_it_is(page):
    write = """async text => {
      const {setSentence} = await import("/static/dom.js");
      const line = document.createElement("p");
      setSentence(line, text);
      return line.innerHTML;
    }"""
    for text, shown in (
        ("plug it in; see `dmesg`", "Plug it in; see <code>dmesg</code>"),
        ("/tmp/c.yaml: saved", "/tmp/c.yaml: saved"),
        ("v4l2:/dev/video0: gone", "v4l2:/dev/video0: gone"),
        ("camera.gain: <b>", "camera.gain: &lt;b&gt;"),
    ):
        assert page.evaluate(write, text) == shown


def test_a_page_without_a_service_offers_nothing_that_needs_one(browser, tmp_path):
    alone = Server(tmp_path)
    alone.start_page()
    page = browser.new_page()
    try:
        page.goto(alone.owner_url)
        page.get_by_text("offline", exact=True).wait_for()
        for panel in ("Tune", "Expert", "Draw"):
            choose(page, panel)
            assert "service" in page.locator(f"#panel-{panel}").inner_text()
            assert page.locator(f"#panel-{panel} button:enabled:visible").count() == 0
    finally:
        page.close()
        alone.end_page()


@pytest.mark.slow
def test_all_panels_are_reached_by_keyboard_alone(page):
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.getAttribute('role')") == "tab":
            break
    for panel in PANELS:
        assert page.evaluate("document.activeElement.textContent") == panel
        assert page.locator(f"#panel-{panel}").is_visible()
        page.keyboard.press("Tab")
        assert page.evaluate(f"document.getElementById('panel-{panel}').contains(document.activeElement)"), panel
        page.keyboard.press("Shift+Tab")
        page.keyboard.press("ArrowRight")


def violations(page):
    """Return the findings of axe in each panel, and the panels that are wider than the window."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    found = []
    for panel in PANELS:
        choose(page, panel)
        if page.evaluate("document.documentElement.scrollWidth > innerWidth"):
            found.append((panel, "scrolls sideways", []))
        report = axe.Axe().run(page, options={"resultTypes": ["violations"]}).response  # a third of the time
        assert len(report["passes"]) > 20
        found += [(panel, v["id"], [node["html"] for node in v["nodes"]]) for v in report["violations"]]
    return found


def test_axe_finds_no_violation(page):
    assert violations(page) == []


@pytest.mark.slow
@pytest.mark.parametrize(("size", "scheme"), [("desktop", "light"), ("phone", "dark"), ("phone", "light")])
def test_axe_finds_no_violation_in_another_size_or_scheme(open_page, size, scheme):
    assert violations(open_page(*SIZES[size], scheme)) == []


def test_a_hidden_page_asks_for_no_picture(page):
    sent = []

    def note(text):  # Playwright takes no method of a list
        sent.append(text)

    page.on("websocket", lambda live: live.on("framesent", note))
    page.reload()
    wait_for("pictures", lambda: page.wait_for_timeout(20) or len(sent) > 3)
    page.evaluate("""Object.defineProperty(document, 'hidden', {value: true});
                     document.dispatchEvent(new Event('visibilitychange'))""")
    wait_for("rest", lambda: page.wait_for_timeout(20) or '{"type":"rest"}' in sent)
    number = len(sent)
    page.wait_for_timeout(1000)
    assert len(sent) == number


@pytest.fixture
def searched(page, service):
    """Return the page with a search, of which the number of hits is checked at the end."""
    choose(page, "Expert")
    page.locator("#search").fill("blobs")
    shown = page.locator("#panel-Expert .setting:visible")
    before = shown.count()
    yield page
    assert page.locator("#search").input_value() == "blobs"
    assert shown.count() == before


def check_first_picture(page):
    begun = time.monotonic()
    page.locator("#picture-rate", has_text="pictures/s").wait_for()
    assert time.monotonic() - begun <= 2.0


def test_the_picture_is_back_two_seconds_after_another_page_process_answers(searched, service):
    service.end_page()
    searched.get_by_text("offline", exact=True).wait_for()
    assert searched.get_by_role("button", name="Snapshot").is_disabled()
    service.start_page()
    check_first_picture(searched)
    searched.get_by_text("tracking", exact=True).wait_for()


@pytest.mark.slow
def test_a_page_process_that_stands_still_is_reported(page, service):
    service.signal_page(signal.SIGSTOP)
    try:
        page.get_by_text("offline", exact=True).wait_for()
        assert "does not answer" in page.locator("#reason").inner_text()
    finally:
        service.signal_page(signal.SIGCONT)
    page.get_by_text("tracking", exact=True).wait_for()


@pytest.mark.slow
def test_the_picture_is_back_two_seconds_after_another_service_tracks(searched, service):
    service.end_daemon()
    searched.get_by_text("offline", exact=True).wait_for()
    searched.locator("#picture-rate", has_text="not live").wait_for()
    assert "open Guide" in searched.locator("#advice").inner_text()
    service.start_daemon()
    service.reach(state="tracking")
    check_first_picture(searched)
    searched.get_by_text("tracking", exact=True).wait_for()
