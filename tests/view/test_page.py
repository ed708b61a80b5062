"""The page in a browser, on a service that tracks a film."""

import io
import json
import re
import signal
import time

import numpy as np
import pytest
from PIL import Image
from view_world import Server, wait_for

PANELS = ("Tune", "Expert", "Log", "Draw", "Recordings", "Outputs", "Doctor", "Calibration", "Guide")
SIZES = {"desktop": (1280, 800), "phone": (390, 844)}
DRAWN = "canvas => canvas.toDataURL()"  # a screenshot also shows where it lies


def choose(page, panel):
    page.locator(f"#tab-{panel}").click()


def field(page, panel, key):
    return page.locator(f'[id="{panel}-{key}"]')


def enter(control, text):
    control.fill(text)
    control.press("Enter")


def refusal(page, panel, key):
    return page.locator(f'[id="{panel}-{key}-error"]')


def pixels(page):
    """Return the middle of the camera's picture, where the ball is, as numbers."""
    picture = np.asarray(Image.open(io.BytesIO(page.locator("#picture").screenshot())).convert("L"), dtype=float)
    rows, columns = picture.shape
    return picture[rows // 4 : -rows // 4, columns // 3 : -columns // 3]


def drag(page, *places):
    """Press the mouse at the first place, move it to the others, and release it."""
    (x, y), *others = places
    page.mouse.move(x, y)
    page.mouse.down()
    for place in others:
        page.mouse.move(*place, steps=4)
    page.mouse.up()


def middle(locator):
    box = locator.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def begin_drawing(page):
    """Open the panel Draw, and wait until the rectangles of the test before are gone from it."""
    choose(page, "Draw")
    wait_for("no rectangle", lambda: page.locator(".masks li").count() == 0)


def masks(service):
    """Return the numbers of all places without discs."""
    return [float(n) for n in re.findall(r"-?[\d.]+", value(service, "discs.masks") or "")]


def value(service, key):
    """Return a setting as the daemon reports it."""
    changes = dict(change.split("=", 1) for change in service.status()["changes"])
    return changes.get(key)


# ---- what is seen ----


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


# ---- the service obeys ----


def test_buttons_reach_the_service(page, service):
    age = service.status()["pose"]["age_s"]
    for button, done in (
        ("Pause", lambda: service.status()["paused"]),
        ("Resume", lambda: not service.status()["paused"]),
        ("Record", lambda: service.status()["recording"]),
        ("Stop recording", lambda: service.status()["recording"] is None),
        ("Snapshot", lambda: [*service.folder.rglob("*.png"), *service.folder.rglob("*.jpg")]),
        ("Estimate camera pose", lambda: (service.status()["pose"] or {"age_s": age})["age_s"] < age),
    ):
        page.get_by_role("button", name=button).click()
        wait_for(button, done)
    service.reach(state="tracking")


@pytest.mark.slow
def test_each_setting_of_daily_use_reaches_the_service(page, service):
    rows = page.locator("#panel-Tune .setting")
    keys = [row.get_attribute("data-key") for row in rows.all()]
    assert len(keys) >= 8
    for key in keys:
        control = field(page, "tune", key)
        kind = control.evaluate("e => e.tagName === 'SELECT' ? 'select' : e.type")
        if kind == "checkbox":
            control.click()
        elif kind == "select":
            control.select_option(index=1 + control.evaluate("e => e.selectedIndex > 0 ? -1 : 0"))
        else:
            slider = page.locator(f'[data-key="{key}"] .slider')
            if not slider.is_visible():
                continue
            slider.focus()
            page.keyboard.press("ArrowLeft")
        wait_for(key, lambda key=key: value(service, key) or refusal(page, "tune", key).inner_text())
        assert not refusal(page, "tune", key).inner_text() or key.startswith("camera."), key


def test_a_gesture_on_a_slider_is_one_step_of_undo(page, service):
    undo = page.locator("#undo")
    x, y = middle(page.locator('[data-key="motion.scale_x"] .slider'))
    drag(page, (x, y), *((x + 12 * i, y) for i in range(1, 6)))
    chosen = field(page, "tune", "motion.scale_x").input_value()
    assert float(chosen) > 1.5
    wait_for("the last value", lambda: float(value(service, "motion.scale_x") or 0) == float(chosen))
    assert not page.locator(".comparison").is_visible()  # no stage of the picture changes
    wait_for("a step", lambda: undo.inner_text() != "Undo")
    steps = undo.inner_text()
    undo.click()
    wait_for("the first value", lambda: float(value(service, "motion.scale_x") or 1) == 1)
    wait_for("one step less", lambda: undo.inner_text() != steps)


def test_the_stage_that_a_setting_changes_is_shown_before_and_now(page, service):
    slider = page.locator('[data-key="discs.contrast"] .slider')
    slider.scroll_into_view_if_needed()
    box = slider.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    figures = page.locator(".comparison figure")
    figures.first.wait_for()
    before = figures.first.locator("canvas").evaluate(DRAWN)
    words = re.fullmatch(r"Before: (\d+) of (\d+) contours used", figures.first.inner_text())
    assert 0 < int(words[1]) <= int(words[2])
    assert figures.last.inner_text().startswith("Now: ")
    page.mouse.move(box["x"] + box["width"] - 1, box["y"] + box["height"] / 2)  # no disc has so much contrast
    wait_for("no contour", lambda: figures.last.inner_text() == "Now: 0 of 0 contours used")
    stays = figures.first.locator("canvas").evaluate(DRAWN) == before
    assert stays  # pytest takes minutes to compare the bytes
    page.mouse.up()
    page.locator("#undo").click()
    wait_for("the contours", lambda: int(re.search(r"\d+", figures.last.inner_text())[0]) >= int(words[1]) - 2)


def test_a_value_that_is_refused_is_refused_in_words_and_stays_to_be_corrected(page, service):
    scale = field(page, "tune", "motion.scale_x")
    enter(scale, "two")
    wait_for("the refusal", lambda: "must be a number" in refusal(page, "tune", "motion.scale_x").inner_text())
    assert scale.input_value() == "two"
    assert value(service, "motion.scale_x") is None
    enter(scale, "1,5")
    wait_for("the value", lambda: value(service, "motion.scale_x") == "1.5")
    assert refusal(page, "tune", "motion.scale_x").inner_text() == ""


@pytest.mark.slow
def test_a_value_on_its_way_survives_a_connection_that_begins_again(page):
    sent = page.evaluate("""async () => {
      const {Settings} = await import("/static/settings.js");
      const sent = [], known = (keys) => keys.map((key) => ({key, value: 0, saved: 0}));
      const settings = new Settings({request: async (kind, {values}) => {
        await new Promise((done) => setTimeout(done, 20));
        sent.push(values);
      }});
      for (const keys of [["a", "b"], ["a"]]) {  // the same tracker, and another
        settings.load(known(["a", "b"]));
        settings.change("a", 1);
        settings.change("b", 2);
        settings.load(known(keys));
        await new Promise((done) => setTimeout(done, 100));
      }
      return sent;
    }""")
    assert sent == [{"a": 1}, {"b": 2}, {"a": 1}]


def test_a_field_with_focus_is_not_overwritten(page, service):
    scale = field(page, "tune", "motion.scale_x")
    scale.focus()
    page.keyboard.press("Control+a")
    page.keyboard.type("3.2")
    service.ask("set", assignments=["motion.scale_x=7", "motion.scale_y=6"])
    wait_for("the other field", lambda: field(page, "tune", "motion.scale_y").input_value() == "6")
    assert scale.input_value() == "3.2"
    page.keyboard.press("Enter")
    wait_for("the typed value", lambda: value(service, "motion.scale_x") == "3.2")


def test_a_page_without_the_token_shows_and_changes_nothing(open_page, service):
    service.ask("set", assignments=["motion.scale_y=1.25"])
    page = open_page(owner=False)
    assert "the address that spheremouse view --url prints" in page.locator("header .visitors").inner_text()
    wait_for("a locked field", field(page, "tune", "motion.scale_x").is_disabled)
    page.get_by_text("1 unsaved").wait_for()
    assert all(page.locator(button).is_disabled() for button in ("#pause", "#undo", "#save", "#apply-profile"))
    choose(page, "Expert")
    assert all(page.locator(button).is_disabled() for button in ("#reset-all", "#import", "#export"))
    for panel in ("Draw", "Recordings", "Doctor", "Calibration", "Guide"):
        choose(page, panel)
        shown = page.locator(f"#panel-{panel}")
        assert "Only the owner" in shown.locator(".visitors").inner_text()
        assert shown.locator("button").count() > 0
        assert shown.locator("button:enabled, input:enabled, select:enabled").count() == 0
    choose(page, "Draw")
    x, y = middle(page.locator("#picture"))
    drag(page, (x, y), (x + 40, y + 30))
    wait_for("the ball", lambda: pixels(page).max() > 100)
    assert value(service, "discs.masks") is None
    assert page.locator("#message").is_hidden()  # nothing was refused, since nothing was asked


def test_a_browser_whose_token_is_not_valid_any_more_is_told_what_to_do(open_page, service):
    page = open_page()
    assert page.locator("header .visitors").is_hidden()
    page.context.add_cookies(
        [{**cookie, "value": "of-another-page"} for cookie in page.context.cookies() if "spheremouse" in cookie["name"]]
    )
    page.reload()
    page.locator("header .visitors").wait_for()
    page.goto(service.owner_url)
    page.get_by_text("tracking", exact=True).wait_for()
    assert page.locator("header .visitors").is_hidden()


def test_a_page_that_refuses_this_browser_gives_the_reason(page):
    page.route("**/", lambda route: route.fulfill(status=403, body="403: the reason"))
    page.evaluate("WebSocket.prototype.send = function () { this.close(); }")  # ends the connection
    wait_for("the reason", lambda: "the reason" in page.locator("#reason").inner_text())


def test_save_keeps_the_comments_of_the_file(page, service):
    file = service.folder / "config.yaml"
    before = file.read_text()
    service.ask("set", assignments=["motion.scale_x=1.25"])
    page.get_by_text("unsaved", exact=True).first.wait_for()
    page.locator("#save").click()
    wait_for("the file", lambda: "scale_x: 1.25" in file.read_text())
    assert "# kept by `save`" in file.read_text()
    wait_for("no mark", lambda: page.locator("#save").is_disabled())
    file.write_text(before)


@pytest.mark.slow
def test_expert_settings_are_searched_changed_and_reset(page, service):
    choose(page, "Expert")
    rows = page.locator("#panel-Expert .setting:visible")
    everything = rows.count()
    page.locator("#search").fill("blobs.area")
    assert rows.count() == 1 < everything
    area = field(page, "expert", "blobs.area")
    enter(area, "[50, 300]")
    wait_for("the value", lambda: value(service, "blobs.area"))
    page.locator("#search").fill("lost_after")
    assert "0 of" in (count := page.locator("#panel-Expert .help").first.inner_text())
    assert count.endswith("Tune has 1 more.")
    page.locator("#search").fill("")
    page.get_by_label("changed only").check()
    wait_for("the changed ones", lambda: 1 <= rows.count() < everything)
    page.locator("#reset-all").click()
    wait_for("the default", lambda: field(page, "expert", "blobs.area").input_value() != "[50, 300]")


@pytest.mark.slow
def test_a_rectangle_without_discs_can_be_drawn(page, service):
    begin_drawing(page)
    x, y = middle(page.locator("#picture"))
    drag(page, (x, y), (x + 40, y + 30))
    left, top, right, bottom = wait_for("a rectangle", lambda: masks(service))
    assert left == pytest.approx(320, abs=3)
    assert top == pytest.approx(240, abs=3)
    assert (right - left) / (bottom - top) == pytest.approx(40 / 30, abs=0.1)


@pytest.mark.slow
def test_a_rectangle_without_discs_can_be_changed_by_keys_and_numbers(page, service):
    begin_drawing(page)
    page.locator("#add-mask").click()
    left, top, right, bottom = wait_for("a rectangle", lambda: masks(service))
    page.get_by_label("left").wait_for()  # until the daemon has confirmed it, the page shows the value before
    page.locator("#picture").focus()
    page.keyboard.press("ArrowLeft")
    wait_for("its place", lambda: masks(service) == [left - 4, top, right - 4, bottom])
    enter(page.get_by_label("left"), "12")
    wait_for("its edge", lambda: masks(service) == [12, top, right - 4, bottom])
    page.locator("#picture").focus()
    page.keyboard.press("Delete")
    wait_for("none", lambda: masks(service) == [])


@pytest.mark.parametrize("by", ["mouse", "keys"])
def test_a_polygon_without_discs_can_be_drawn_and_changed(page, service, by):
    begin_drawing(page)
    shown = lambda: masks(service)  # noqa: E731
    page.get_by_role("button", name="Draw polygon").click()
    if by == "keys":  # 4 px a step, from the middle
        for key in ("Enter", *["ArrowRight"] * 10, "Enter", *["ArrowDown"] * 10, "Enter", "Enter"):
            page.keyboard.press(key)
        wait_for("a triangle", lambda: shown() == [320, 240, 360, 240, 360, 280])
        enter(page.get_by_label("y 3"), "300")
        wait_for("its corner", lambda: shown()[-2:] == [360, 300])
        return
    x, y = middle(page.locator("#picture"))
    for at in ((0, 0), (60, 0), (60, 60), (0, 60), (0, 60)):
        page.mouse.click(x + at[0], y + at[1])
    square = wait_for("a square", shown)
    assert len(square) == 8
    assert (square[2] - square[0]) / (square[5] - square[1]) == pytest.approx(1.0, abs=0.1)
    drag(page, (x + 60, y), (x + 40, y + 20))
    wait_for(
        "its corner", lambda: shown()[:2] == square[:2] and shown()[2] < square[2] - 10 and shown()[4:] == square[4:]
    )
    drag(page, (x + 30, y + 40), (x + 30, y))
    wait_for("its place", lambda: shown()[1] < square[1] - 20)


@pytest.mark.slow
def test_a_colour_is_picked_from_the_picture_by_keys(page, service):
    choose(page, "Draw")
    page.get_by_role("button", name="Pick cyan").click()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Enter")
    low, high = map(float, re.findall(r"\d+", wait_for("a hue", lambda: value(service, "rings.cyan"))))
    assert 0 < high - low <= 30


def test_the_log_is_filtered(page, service):
    choose(page, "Log")
    lines = page.locator(".log p:visible")
    service.ask("set", assignments=["motion.scale_z=4"])
    page.locator(".log").get_by_text("motion.scale_z").first.wait_for()
    before = lines.all_inner_texts()
    assert all(re.match(r"\d\d:\d\d:\d\d", text) for text in before)
    page.reload()
    choose(page, "Log")
    wait_for("the same lines with their times", lambda: lines.all_inner_texts()[: len(before)] == before)
    page.locator("#log-filter").fill("scale_z")
    assert all("scale_z" in text for text in lines.all_inner_texts())
    page.locator("#log-filter").fill("no such line")
    assert lines.count() == 0


@pytest.mark.slow
def test_a_recording_is_replayed_step_by_step_and_two_settings_are_compared(page, service):
    choose(page, "Recordings")
    page.locator("#recording").select_option("clip")
    page.locator("#play").click()
    page.get_by_text("replay: tracking", exact=True).wait_for(timeout=60000)
    assert "not the recording" in page.locator("#advice").inner_text()
    position = page.locator(".player .help")
    first = position.inner_text()
    wait_for("another frame", lambda: position.inner_text() != first)
    page.locator("#step").click()
    page.get_by_text("replay: paused", exact=True).wait_for()
    frame = lambda: int(re.findall(r"\d+", position.inner_text())[0])  # noqa: E731
    before = wait_for("the position", frame)
    page.locator("#step").click()
    wait_for("the next frame", lambda: frame() == before % 50 + 1)
    enter(page.locator("#replay-end"), "1")
    page.locator("#hold").click()
    page.get_by_text("replay: tracking", exact=True).wait_for()
    choose(page, "Tune")
    sigma = field(page, "tune", "so3.acceleration_sigma")
    enter(sigma, "100")
    page.get_by_text("unsaved", exact=True).first.wait_for()
    assert value(service, "so3.acceleration_sigma") is None
    choose(page, "Recordings")
    page.locator("#compare").click()
    page.locator("#stop-compare").click()
    page.get_by_text("the comparison was ended").wait_for()
    assert page.locator("#stop-compare").is_hidden()
    page.locator("#compare").click()
    rows = page.locator("#panel-Recordings tbody tr")
    rows.first.wait_for(timeout=60000)
    saved, present = (float(text.split("°")[0]) for text in rows.first.locator("td").all_inner_texts())
    assert saved < present
    page.locator("#leave").click()
    page.get_by_text("tracking", exact=True).wait_for()
    wait_for("the setting at the camera", lambda: value(service, "so3.acceleration_sigma") == "100")


def test_a_report_of_a_calibration_is_shown_and_nonsense_refused_with_its_reason(page, service):
    view = {"file": "board_1.jpg", "rms_px": 0.0456, "corners": 88, "why": None}
    lens = {"fx": 500.0, "fy": 501.0, "cx": 320.0, "cy": 240.0, "dist": [0.1, 0, 0, 0, 0], "sigma": [0.25] * 9}
    camera = {"width": 640, "height": 480, **lens}
    figures = {"camera": camera, "rms_px": 0.05, "board_views": [view], "advice": ["Good."]}
    (service.folder / "lens.json").write_text(json.dumps(figures))
    (service.folder / "rig.json").write_text("{")
    choose(page, "Calibration")
    panel = page.locator("#panel-Calibration")
    panel.get_by_text("board_1.jpg").wait_for()
    cells = [row.split("\t") for row in panel.locator("tr").all_inner_texts()]
    assert ["fx", "500.00 px", "0.25 px"] in cells
    assert ["board_1.jpg", "0.046", "88"] in [row[:3] for row in cells]
    assert "is no valid report" in panel.locator(".refused").inner_text()


@pytest.mark.slow
def test_the_doctor_reports_and_carries_out_a_remedy(page, service):
    choose(page, "Doctor")
    service.ask("pause")
    page.locator("#doctor").click()
    page.locator("#panel-Doctor").get_by_role("button", name="Resume").click(timeout=60000)
    service.reach(paused=False)


# ---- everybody can use it ----


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


# ---- the connection ----


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
