"""`spheremouse axes`: gestures in, the setting out, and the configuration told."""

from types import SimpleNamespace

import numpy as np
import pytest
from seats import LOOKS

from spheremouse.commands.axes.dialogue import Dialogue
from spheremouse.errors import CalibrationError
from spheremouse.files import config
from spheremouse.session.settings import Configuration
from spheremouse.tracker import unknown

FILM = "synthetic:motion=axes,noise=3,seed=2"
UP = np.array([0.0, 1.0, 0.0])


@pytest.mark.slow
def test_a_player_on_the_far_side_is_understood_and_the_file_or_a_profile_told(spheremouse, tmp_path):
    """The film shows 60° right, away, and counter-clockwise, as somebody opposite the camera does it."""
    file = tmp_path / "config.yaml"
    motion = "motion:\n  player: left  # guessed\n  invert_y: true\n"
    file.write_text(f"schema: 2\n{motion}profiles:\n  doom: {{motion.scale_x: 2}}  # fast\n")
    for name in ("doom", "menu"):
        spheremouse.succeed("axes", "--config", file, "--profile", name, "--source", FILM)
    assert motion in file.read_text()
    profiles = config.load(file, Configuration).profiles
    found = ("motion.player='far-side'", "motion.invert_y=false")
    assert set(profiles["doom"]) == {"motion.scale_x=2", *found}
    assert set(profiles["menu"]) == set(found)
    assert "--profile doom: needs --config FILE" in spheremouse.fail("axes", "--profile", "doom", "--source", FILM)
    out, _ = spheremouse.succeed("axes", "--config", file, "--source", FILM)
    assert "understood: you stand on the far side of the ball, opposite the camera" in out
    assert out.count("seen: 60°") == 3
    assert out.splitlines()[-3:] == [
        "motion.player: far-side (was left)",
        "motion.invert_y: false (was true)",
        f"{file}: saved",
    ]
    saved = config.load(file, Configuration).motion
    assert (saved.player, saved.invert_y) == ("far-side", False)
    assert all(comment in file.read_text() for comment in ("# guessed", "# fast"))


@pytest.mark.slow
def test_a_configuration_is_begun_with_what_the_command_line_said(spheremouse, tmp_path):
    """So that `run --config` needs nothing else."""
    config_file = tmp_path / "cabinet" / "config.yaml"
    config_file.parent.mkdir()
    given = ("--config", config_file, "--source", FILM, "--set", "motion.scale_y=2")
    code, out, err = spheremouse("axes", *given, "--dry-run")
    assert (code, out.splitlines()[-1]) == (0, "nothing is saved"), err
    assert not config_file.exists()
    code, out, err = spheremouse("axes", *given)
    assert (code, out.splitlines()[-2]) == (0, f"{config_file}: saved"), err
    assert out.splitlines()[-1].startswith("it names no camera yet: add a line such as `source: ")
    saved = config.load(config_file, Configuration)
    assert (saved.source, saved.motion.player, saved.motion.scale_y) == (None, "far-side", 2.0)  # a film is no camera


def test_who_cannot_save_hears_so_before_the_first_gesture(spheremouse, tmp_path):
    path = tmp_path / "no" / "config.yaml"
    said = spheremouse.fail("axes", "--config", path, "--source", FILM)
    assert said == f"{path}: cannot be written: there is no folder {path.parent}"


@pytest.mark.slow
def test_a_film_without_gestures_is_refused_in_a_line(spheremouse):
    code, _, err = spheremouse("axes", "--source", "synthetic:motion=still,seconds=2")
    assert code == 2
    assert "0 of 3 gestures were seen; missing: 'roll the ball to the right" in err
    assert "Traceback" not in err


class Played:
    """Motions as a adapter gives them."""

    def __init__(self, configuration, live=True):
        self.stopping = SimpleNamespace(stop_requested=False)
        self.dialogue = Dialogue(configuration, self.stopping, live)
        self._t = 0.0
        self.rest()

    def frame(self, turn, shift):
        self._t += 0.05
        estimate = unknown(self._t)._replace(increment=np.concatenate([turn, shift]), confirmed=True)
        result = SimpleNamespace(samples=(SimpleNamespace(estimate=estimate),), pointing=0, seconds={})
        self.dialogue.show(result, SimpleNamespace(counts=(0, 0, 0)), None)

    def rest(self):
        for _ in range(30):
            self.frame(np.zeros(3), np.zeros(3))

    def make(self, *gestures, of="turn"):
        """A second each, and a rest."""
        for way in gestures:
            for _ in range(20):
                part = np.array(way, dtype=float) / 20
                self.frame(*((part, np.zeros(3)) if of == "turn" else (np.zeros(3), part)))
            self.rest()


def by_hand(player):
    """Rotation vectors of a ball whose top goes to the player's right, and away; and a spin."""
    ahead = np.array(LOOKS[player], dtype=float)
    return np.cross(UP, np.cross(ahead, UP)), np.cross(UP, ahead), UP


@pytest.mark.parametrize("player", LOOKS)
def test_each_seat_is_told_by_its_gestures(player, capsys):
    played = Played(Configuration())
    played.make(*by_hand(player))
    assert played.stopping.stop_requested
    ((name, value, _),) = played.dialogue.conclusion()
    assert (name, value) == ("motion.player", player)
    assert capsys.readouterr().out.count("of 3:") == 3


def test_a_gesture_that_is_under_way_when_it_is_interrupted_counts_for_nothing():
    right, away, spin = by_hand("left")
    played = Played(Configuration())
    played.make(right, away)
    for _ in range(10):
        played.frame(spin / 10, np.zeros(3))
    played.stopping.stop_requested = True  # Ctrl-C
    assert played.dialogue.conclusion() == []
    assert played.dialogue.stopped


def test_what_was_wrong_is_asked_for_again(capsys):
    """To and fro: that one once more. Not as any player's: all of them."""
    right, away, spin = by_hand("left")
    played = Played(Configuration())
    for _ in range(2):
        played.make(right)  # the second time taken for the second gesture; no seat has it
    played.make(spin)
    assert "not understood" in capsys.readouterr().out
    assert not played.stopping.stop_requested
    for k in range(20):  # there and most of the way back
        played.frame(right / 10 if k < 10 else -0.8 * right / 10, np.zeros(3))
    played.rest()
    assert "to and fro" in capsys.readouterr().out
    played.make(right, away, spin)
    ((_, value, _),) = played.dialogue.conclusion()
    assert value == "left"


def test_a_recording_of_a_mirror_image_is_refused():
    right, away, spin = by_hand("right")
    played = Played(Configuration(), live=False)
    with pytest.raises(CalibrationError, match=r"not understood.*push the top of the ball") as refused:
        played.make(right, -away, spin)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("facing", [True, False])
@pytest.mark.parametrize("by", ["turn", "shift"])
def test_a_hand_is_told_as_well(by, facing):
    down = np.array([0.0, 1.0, 0.0])
    look = np.array([0.0, 0.0, -1.0 if facing else 1.0])
    right = np.cross(down, look)
    shifts = right, -down, look
    turns = np.cross(look, right), np.cross(look, -down), np.cross(-down, right)
    settings = config.in_force(
        None, ("tracker=wand", f"wand.pointing.by={by}", "wand.pointing.invert_x=true"), Configuration
    )
    played = Played(settings)
    played.make(*(turns if by == "turn" else [0.4 * s for s in shifts]), of=by)
    told = {name: value for name, value, _ in played.dialogue.conclusion()}
    assert told == {"wand.pointing.facing": facing, "wand.pointing.invert_x": False}
