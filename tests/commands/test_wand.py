"""The hand-held ball on the command line: films, colours, distance and light."""

import json
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from experiments.kit.balls import contrast_ball, led_ball
from invoking import fail, invoke, succeed

from spheremouse.commands import app
from spheremouse.errors import ConfigurationError
from spheremouse.files.wand import load_wand, save_wand
from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.colour import DEFAULT_COLOURS
from spheremouse.wand.pick_colours import Circle, check_bounds, pick_bounds
from spheremouse.wand.settings import ColourSettings

ok, refused = partial(succeed, app), partial(fail, app)


def first_picture(ball=None, **options):
    """The first picture of a ball in a hand, and the circle of the ball."""
    film = prepare_wand(WandOptions(motion="hand", size=(640, 480), **options), ball)
    shot = next(iter(simulate_wand(film)))
    (x, y, z), c = shot.position[0], film.scene.camera
    return shot.frame.image, Circle(c.cx + c.fx * x / z, c.cy + c.fy * y / z, c.fx * 0.05 / z)


@pytest.fixture(scope="module")
def shot():
    return first_picture(seed=1, begin=40 / 15, seconds=0.1)


@pytest.fixture
def picture(shot, tmp_path):
    path = tmp_path / "hand.png"
    cv2.imwrite(str(path), shot[0])
    return path


def test_a_film_is_made_and_evaluated(tmp_path):
    out = tmp_path / "film"
    words = ("--path", "hand", "--seconds", 0.6, "--seed", 3, "--size", "640x480", "--blur", 0.005, "--distance", 1.5)
    said = ok("wand", "simulate", out, *words)
    assert said.startswith(f"{out}: 9 frames of 640x480 at 15 Hz, motion hand, ball grzonka; ")
    assert f"next: spheremouse evaluate {out} --tracker wand" in said
    truth = np.genfromtxt(out / "truth.csv", delimiter=",", names=True)
    assert np.abs(truth["z"] - 1.5).max() < 0.2 * 1.5
    said = ok("evaluate", out, "--tracker", "wand", "--runs", 2, "--pose", "known", "--json", tmp_path / "a.json")
    figures = json.loads((tmp_path / "a.json").read_text())
    assert (figures["dataset"], figures["tracker"], figures["frames"], figures["runs"]) == ("film", "wand", 9, 2)
    assert set(figures["position_p95_mm"]) == {"x", "y", "z"}
    assert figures["lost_runs"] in (0, 1, 2)
    assert figures["fps"] > 0.0
    assert "is not empty; name another folder or use --force" in refused("wand", "simulate", out, "--seconds", 1)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--detector", "blobs"), "--detector: does not go with --tracker wand; leave it out"),
        (("--set", "wand.partikles=3"), "--set wand.partikles: unknown key; did you mean wand.particles"),
        (("--ball", "none.yaml"), "none.yaml: no such file"),
    ],
)
def test_evaluate_refuses_what_does_not_go_with_a_wand(tmp_path, words, said):
    (tmp_path / "scene.json").write_text('{"wand": 1}')
    assert said in refused("evaluate", tmp_path, "--tracker", "wand", *words)


@pytest.mark.parametrize(("option", "value"), [("--runs", 0), ("--pose", "maybe")])
def test_evaluate_refuses_other_values(tmp_path, option, value):
    code, said = invoke(app, "evaluate", tmp_path, "--tracker", "wand", option, value)
    assert (code, f"Invalid value for '{option}'" in said) == (2, True)


def test_the_ball_is_found_and_its_bounds_select_its_discs(shot):
    image, true = shot
    picked = pick_bounds(image, grzonka_ball())
    assert np.hypot(picked.circle.u - true.u, picked.circle.v - true.v) < 0.1 * true.radius
    assert picked.circle.radius == pytest.approx(true.radius, rel=0.1)
    red, blue = picked.colours["red"], picked.colours["blue"]
    assert red.hue_min > 330
    assert red.hue_max < 25
    assert 200 < blue.hue_min < blue.hue_max < 255
    for name in ("red", "blue"):
        assert 0.02 < picked.inside[name] < 0.4
        assert picked.outside[name] < 0.02


def test_bounds_follow_the_light(shot):
    """Under blue light, in which white is blue, the bounds picked are others, and still select the discs alone."""
    image, circle = shot
    tinted = np.clip(image * np.array([1.0, 0.9, 0.7]), 0, 255).astype(np.uint8)
    picked = pick_bounds(tinted, grzonka_ball())
    plain = pick_bounds(image, grzonka_ball(), circle)
    assert picked.colours["blue"].saturation_min > plain.colours["blue"].saturation_min
    for name in ("red", "blue"):
        assert picked.inside[name] == pytest.approx(plain.inside[name], abs=0.03)
        assert picked.outside[name] < 0.02


def test_one_colour_is_split_by_brightness():
    image, circle = first_picture(contrast_ball(), seed=2, seconds=1.0)
    picked = pick_bounds(image, contrast_ball(), circle)
    assert 0.05 < picked.inside["dark"] < 0.35
    assert 40 < picked.colours["dark"].value_max < 140


def test_the_command_writes_bounds_and_picture_and_its_next_step_can_be_taken(picture, shot, tmp_path):
    """The overlay is made anew each time; what may be somebody's own is not touched."""
    shown, out, own = tmp_path / "hand.png.colours.png", tmp_path / "wand.yaml", tmp_path / "own.png"
    said = ok("wand", "colours", picture)
    for words in ("the ball is at", "red: hue_min", "next: look at the picture, then write the bounds with --out"):
        assert words in said
    whole = shown.read_bytes()
    overlay = cv2.imread(str(shown))
    assert overlay.shape == (480, 640 + 240, 3)
    red = np.all(overlay[:, :640] == (60, 60, 255), axis=2)
    assert 0 < np.count_nonzero(red) < 0.05 * red.size
    shown.write_bytes(b"of an earlier picture")
    ok("wand", "colours", picture, "--out", out)
    assert shown.read_bytes() == whole
    file = load_wand(out)
    assert file.ball.colours == ("blue", "red")
    assert file.colours["red"] != DEFAULT_COLOURS["red"]
    assert "selects" in ok("wand", "colours", picture, "--check", "--ball", out)
    cv2.imwrite(str(tmp_path / "hand.jpg"), shot[0])
    ok("wand", "colours", tmp_path / "hand.jpg")
    assert (tmp_path / "hand.jpg.colours.png").is_file()
    own.write_bytes(b"a photo")
    (tmp_path / "folder.colours.png").mkdir()
    for words, said in (
        (("--out", out), "wand.yaml: there already; name another file, or replace it with --force"),
        (("--show", own), "own.png: there already; name another file, or replace it with --force"),
        (("--show", tmp_path / "folder.colours.png"), "folder.colours.png: is a folder; name a file"),
        (("--show", picture, "--force"), "hand.png: is read or written by this very command"),
        (("--show", own, "--out", own, "--force"), "own.png: is read or written by this very command"),
    ):
        assert said in refused("wand", "colours", picture, *words)
    assert own.read_bytes() == b"a photo"
    overlay = tmp_path / "named.colours.png"
    picture.rename(overlay)
    assert "is read or written by this very command" in refused("wand", "colours", overlay, "--show", overlay)


def test_bounds_that_select_everything_are_to_be_narrowed(picture, tmp_path):
    everything = {"blue": ColourSettings(), "red": DEFAULT_COLOURS["red"]}
    save_wand(tmp_path / "wide.yaml", grzonka_ball(), everything, {})
    said = refused("wand", "colours", picture, "--check", "--ball", tmp_path / "wide.yaml")
    assert said == "blue: the bounds select 100 % of the picture; narrow them, or have others picked without --check"


def test_light_is_what_a_dark_picture_lacks(tmp_path):
    for level, dark in ((0, True), (12, True), (128, False)):
        path = tmp_path / f"{level}.png"
        cv2.imwrite(str(path), np.full((240, 320, 3), level, np.uint8))
        said = refused("wand", "colours", path)
        assert (f"the picture is dark (mean brightness {level} of 255): give more light" in said) == dark


@pytest.mark.parametrize("seed", [1, 3])
def test_lit_discs_are_told_from_a_bright_room(seed):
    """Bounds take the discs and little of a floor that is nearly as bright."""
    image, true = first_picture(led_ball(), seed=seed, seconds=0.5)
    picked = pick_bounds(image, led_ball())
    assert np.hypot(picked.circle.u - true.u, picked.circle.v - true.v) < 0.1 * true.radius
    assert 0.1 < picked.inside["light"] < 0.25
    assert picked.outside["light"] < 0.02
    assert picked.stray_colours() == []


def plain_ball(body, disc, room):
    """A ball of 40 px radius with four discs before a room, (240, 320, 3): grey levels or BGR."""
    image = np.empty((240, 320, 3), np.uint8)
    image[:] = room
    cv2.circle(image, (160, 120), 40, body, -1)
    for u, v in ((150, 105), (175, 110), (150, 135), (175, 130)):
        cv2.circle(image, (u, v), 6, disc, -1)
    noise = np.random.default_rng(4).normal(0.0, 2.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8), Circle(160.0, 120.0, 40.0)


def test_what_is_beside_the_ball_narrows_bounds_only_where_that_gains():
    """The bound lies between discs and what is nearly like them; what is like them is not gone after, but said."""
    two = grzonka_ball()
    ball = replace(two, discs=tuple(replace(disc, colour="blue") for disc in two.discs))
    white, blue, bluish = (200, 200, 200), (200, 30, 20), (200, 80, 80)  # BGR, the blues of saturation 230 and 153
    picked = {}
    for what, room in (("plain", (128, 128, 128)), ("bluish", bluish), ("blue", blue)):
        image, circle = plain_ball(white, blue, (128, 128, 128))
        image[:, :80] = plain_ball(room, room, room)[0][:, :80]
        picked[what] = pick_bounds(image, ball, circle)
    assert picked["plain"].colours["blue"].saturation_min < 153 < picked["bluish"].colours["blue"].saturation_min < 225
    assert picked["bluish"].outside["blue"] < 0.001
    assert picked["bluish"].inside["blue"] > 0.8 * picked["plain"].inside["blue"]
    assert picked["blue"].colours["blue"].saturation_min == picked["plain"].colours["blue"].saturation_min
    assert picked["blue"].stray_colours() == ["blue"]
    assert picked["plain"].stray_colours() == picked["bluish"].stray_colours() == []


def test_the_hint_is_said_of_brightness_too(tmp_path):
    image, circle = plain_ball((200, 200, 200), (20, 20, 20), (128, 128, 128))
    image[:, :80] = 20
    cv2.imwrite(str(tmp_path / "dark.png"), image)
    save_wand(tmp_path / "ball.yaml", contrast_ball(), {"dark": ColourSettings(value_max=75)}, {})
    words = ("--ball", tmp_path / "ball.yaml", "--at", f"{circle.u},{circle.v},{circle.radius}")
    for also in ((), ("--check",)):
        said = ok("wand", "colours", tmp_path / "dark.png", *words, *also)
        assert "much beside the ball is dark: clear it away, or use another background" in said
        assert ("or narrow the bounds" in said) == bool(also)


def test_what_cannot_be_picked_is_said_in_words(picture, shot, tmp_path):
    empty = tmp_path / "empty.png"
    cv2.imwrite(str(empty), np.full((240, 320, 3), 128, np.uint8))
    for words, said in (
        ((empty,), "no ball with blue and red discs on white is in view"),
        ((tmp_path / "none.png",), "none.png: no such file"),
        ((picture, "--at", "1,2"), "--at 1,2: write 3 numbers, as in 640,480,25: centre and radius in px"),
        ((picture, "--at", "9999,2,5"), "--at 9999,2,5: not in a picture of 640x480 px"),
        ((picture, "--at", "30,30,20"), "blue: no such disc on the ball"),
        ((picture, "--show", "x.jpg"), "must end in .png"),
        ((picture, "--check", "--out", tmp_path / "q.yaml"), "--out: does not go with --check"),
    ):
        assert said in refused("wand", "colours", *words)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty.png", "hand.png"]
    image, circle = shot
    with pytest.raises(ConfigurationError, match="green: the bounds select nothing on the ball"):
        check_bounds(image, {"green": ColourSettings(hue_min=100, hue_max=140, saturation_min=200)}, circle)
    with pytest.raises(ConfigurationError, match=r"light: the bounds select .* % of the picture"):
        check_bounds(image, {"light": ColourSettings(value_min=20)}, circle)


def film(path, **options):
    list(write_wand(path, prepare_wand(WandOptions("hand", seed=2, fps=30.0, size=(640, 480), **options))))
    return path


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return film(tmp_path_factory.mktemp("wand") / "two", seconds=0.4, balls=2)


@pytest.fixture
def ball(tmp_path):
    path = tmp_path / "ball.yaml"
    save_wand(path, grzonka_ball())
    return path


def figures(spheremouse, path, *words):
    out, err = spheremouse.succeed("evaluate", path, "--json", path.parent / "a.json", *words)
    result = json.loads((path.parent / "a.json").read_text())
    return [result, *result.get("more_balls", [])], out, err


def test_a_ball_that_is_never_found_is_a_line_with_the_reason(spheremouse, two, ball, tmp_path):
    none = {c: ColourSettings(hue_min=100.0 + k, hue_max=101.0 + k) for k, c in enumerate(("red", "blue"))}
    save_wand(tmp_path / "none.yaml", grzonka_ball(), none)
    found, _, err = figures(spheremouse, two, "--ball", tmp_path / "none.yaml")
    assert (found[0]["tracked"], found[0]["lost_runs"]) == (0, 1)
    said = f"{two}: grzonka was never found: "
    assert err.count(said) == 1
    assert "no ball like grzonka in view: hold it into the picture" in err.split(said)[1]
    one = film(tmp_path / "one", seconds=0.2)
    second = tmp_path / "second.yaml"
    save_wand(second, replace(grzonka_ball(), name="second"))
    found, out, err = figures(spheremouse, one, "--ball", ball, "--ball", second)
    assert [f["tracked"] for f in found] == [6, 0]
    assert [f["lost_runs"] for f in found] == [0, None]  # there is no truth of a second one
    assert f"{one}: second was never found: " in err
    assert "grzonka was never found" not in err
    (one / "truth.csv").unlink()
    found, out, err = figures(spheremouse, one)
    assert "one" in out
    assert found[0]["position_rmse_mm"]["x"] is None
    assert f"{one}: no truth.csv: no errors are known" in err
