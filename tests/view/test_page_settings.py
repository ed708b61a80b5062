"""The page in a browser changes the service: buttons, settings, drawings, recordings and reports."""

import json
import re

import pytest
from page_panels import begin_drawing, choose, drag, enter, field, masks, middle, pixels, refusal, value
from view_world import wait_for

DRAWN = "canvas => canvas.toDataURL()"  # a screenshot also shows where it lies


def test_buttons_reach_the_service(page, service):
    age, file = service.status()["pose"]["age_s"], service.folder / "config.yaml"
    before = file.read_text()
    service.ask("set", assignments=["motion.scale_x=1.25"])
    page.get_by_text("unsaved", exact=True).first.wait_for()
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
    page.locator("#save").click()
    wait_for("the file", lambda: "scale_x: 1.25" in file.read_text())
    wait_for("no mark", lambda: page.locator("#save").is_disabled())
    file.write_text(before)
    service.reach(state="tracking")


@pytest.mark.slow
def test_each_setting_of_daily_use_reaches_the_service(page, service):
    rows = page.locator("#panel-Tune .setting")
    wait_for("the settings", lambda: rows.count() >= 8)
    keys = [row.get_attribute("data-key") for row in rows.all()]
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
    service.reach(state="tracking")
    # No disc is light. With a high `discs.contrast`, the tracker would still find discs where the map predicts them.
    field(page, "tune", "discs.polarity").select_option("light")
    figures = page.locator(".comparison figure")
    figures.first.wait_for()
    before = figures.first.locator("canvas").evaluate(DRAWN)
    words = re.fullmatch(r"Before: (\d+) of (\d+) contours used", figures.first.inner_text())
    assert 0 < int(words[1]) <= int(words[2])
    wait_for("no contour", lambda: figures.last.inner_text() == "Now: 0 of 0 contours used")
    stays = figures.first.locator("canvas").evaluate(DRAWN) == before
    assert stays  # pytest takes minutes to compare the bytes
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
def test_a_rectangle_without_discs_can_be_drawn_and_changed_by_keys_and_numbers(page, service):
    begin_drawing(page)
    x, y = middle(page.locator("#picture"))
    drag(page, (x, y), (x + 40, y + 30))
    left, top, right, bottom = wait_for("a rectangle", lambda: masks(service))
    assert (left, top) == pytest.approx((320, 240), abs=3)
    assert (right - left) / (bottom - top) == pytest.approx(40 / 30, abs=0.1)
    page.locator("#picture").focus()
    page.keyboard.press("Delete")
    wait_for("none", lambda: masks(service) == [])
    page.locator("#add-mask").click()
    left, top, right, bottom = wait_for("another one", lambda: masks(service))
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
    assert 0 < high - low <= 54


def test_a_picked_colour_is_that_on_white_paper(page):
    """A cyan ring in the light of a bulb: without the paper beside it, its colour counts as green."""
    found = page.evaluate("""async () => {
        const [{ Picture }, { hue }] = await Promise.all([import("/static/picture.js"), import("/static/draw.js")]);
        const canvas = new OffscreenCanvas(320, 240), context = canvas.getContext("2d");
        for (const [colour, size] of [["rgb(60 60 60)", 400], ["rgb(230 180 90)", 30], ["rgb(40 160 80)", 16]]) {
            context.fillStyle = colour;
            context.fillRect(160 - size / 2, 120 - size / 2, size, size);
        }
        const picture = new Picture(document.createElement("canvas"), document.createElement("div"));
        picture.take({ width: 640, height: 480 }, canvas.transferToImageBitmap());
        return [hue(picture.sample([320, 240])).hue, hue(picture.sampleOnWhite([320, 240])).hue];
    }""")
    assert found == [70, 90]


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
