"""From the ball's rate to deflections, curves and a gamepad."""

import contextlib
import os
import struct
import time

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from reporter_world import World
from reporting import refused, rolling, until
from scipy.spatial.transform import Rotation
from seats import LOOKS

from spheremouse.geometry.camera import Pose
from spheremouse.output import Report, full_spec, gamepad, response_of
from spheremouse.output.counts import MotionSettings, OutputCounter
from spheremouse.output.deflection import pointer_rate
from spheremouse.output.response import COUNTS_RESPONSE, Response
from spheremouse.output.sample import Sample
from spheremouse.tracker import Status

FULL = np.radians(180.0)
EVENT = struct.Struct("@llHHi")  # of the kernel: s, us, type, code, value


class Device:
    """Positions of the axes that a program would see."""

    def __init__(self):
        self._events, self.fd = os.pipe()
        os.set_blocking(self._events, False)
        self._axes, self.closed = {}, False

    @property
    def axes(self):
        with contextlib.suppress(BlockingIOError):
            while read := os.read(self._events, 4 * EVENT.size):  # a report: three axes, and its end
                *axes, end = EVENT.iter_unpack(read)
                assert end == (0, 0, 0, 0, 0)
                assert {kind for _, _, kind, _, _ in axes} == {gamepad.EV_ABS}
                self._axes |= {code: value for *_, code, value in axes}
        return self._axes

    def close(self):
        self.closed = True


def sticks(device):
    return tuple(device.axes.get(code, 0) for code in (gamepad.ABS_X, gamepad.ABS_Y, gamepad.ABS_RX))


@pytest.mark.parametrize("player", sorted(LOOKS))
def test_the_sticks_follow_the_hand_of_each_player(player):
    look = np.array(LOOKS[player], dtype=float)
    right, settings = np.cross(look, [0, 1, 0]), MotionSettings(player=player)
    half = Response(full=180.0, dead=0.0)
    made = {
        "right": gamepad.to_sticks(rolling(np.cross([0, 1, 0], right) * FULL / 2, settings), half),
        "away": gamepad.to_sticks(rolling(np.cross([0, 1, 0], look) * FULL / 2, settings), half),
        "clockwise": gamepad.to_sticks(rolling([0, -FULL / 2, 0], settings), half),
    }
    assert made == {"right": (16384, 0, 0), "away": (0, -16384, 0), "clockwise": (0, 0, 16384)}


def test_the_sticks_are_centred_when_reports_stop_and_at_the_end(start):
    device = Device()
    reporter, _ = start(World(), open_it=lambda: gamepad.Gamepad(device, Response()))
    for _ in range(2):
        reporter.submit(rolling([0, -9, 0]), time.monotonic())
        until(lambda: any(sticks(device)))
        until(lambda: sticks(device) == (0, 0, 0))
    reporter.submit(rolling([0, -9, 0]), time.monotonic())
    reporter.close()
    assert sticks(device) == (0, 0, 0)
    assert device.closed


def test_frames_that_are_not_confirmed_do_not_keep_the_sticks_off_the_centre():
    device = Device()
    with gamepad.Gamepad(device, Response()) as output:
        output.send(rolling([0, -9, 0]))

        def centred():
            output.send(rolling([0, -9, 0], confirmed=False))
            return sticks(device) == (0, 0, 0)

        assert not centred()
        until(centred)


RATES = arrays(float, 3, elements=st.floats(-20.0, 20.0))
UP = np.array([0.0, 1.0, 0.0])


@given(st.sampled_from(sorted(LOOKS)), RATES)
def test_the_rate_is_that_of_the_balls_top_for_its_player(player, w):
    made = pointer_rate(rolling(w, MotionSettings(player=player)))
    assert made is not None
    look, top = np.array(LOOKS[player]), np.cross(w, UP)
    assert np.allclose(made, [top @ np.cross(look, UP), -top @ look, w[1]], atol=1e-9)


@given(RATES, st.floats(0.01, 100.0), st.booleans(), st.booleans())
def test_the_scale_of_the_pointer_changes_no_deflection_and_its_inversion_does(w, scale, invert_x, invert_z):
    plain = pointer_rate(rolling(w))
    made = pointer_rate(rolling(w, MotionSettings(counts_per_mm=scale, invert_x=invert_x, invert_z=invert_z)))
    assert plain is not None
    assert made is not None
    assert np.allclose(made, np.array(plain) * np.where([invert_x, False, invert_z], -1.0, 1.0), rtol=1e-9, atol=1e-12)


def test_a_ball_that_is_lost_has_no_rate_and_one_that_is_hidden_keeps_its_own():
    for report in (rolling([1.0, 0.0, 0.0], confirmed=False), rolling([1.0, 0.0, 0.0])._replace(samples=())):
        assert pointer_rate(report) is None
    assert pointer_rate(rolling([1.0, 0.0, 0.0], status=Status.LOST)) == [0.0, 0.0, 0.0]


RESPONSES = st.builds(Response, full=st.floats(1.0, 1e4), dead=st.floats(0.0, 0.9), curve=st.floats(0.2, 5.0))
SIGNED = st.tuples(st.sampled_from(["", "-"]), st.sampled_from("xyz")).map("".join)
AXES = st.lists(SIGNED | st.just("0"), min_size=3, max_size=3)


@given(RESPONSES, RATES)
def test_a_deflection_has_the_direction_of_the_rate_and_at_most_length_one(response, rate):
    made = response.deflection(rate)
    assert np.linalg.norm(made) <= 1.0 + 1e-12
    assert np.allclose(np.cross(made, rate), 0.0, atol=1e-9)
    assert made @ rate >= 0.0


@given(RESPONSES, st.floats(0.0, 1.5))
def test_the_curve_is_zero_in_the_dead_zone_and_one_from_full_on(response, fraction):
    (made,) = response.deflection(np.radians([fraction * response.full]))
    if fraction <= response.dead - 1e-9:
        assert made == 0.0
    elif fraction >= 1.0:
        assert made == pytest.approx(1.0, abs=1e-9)
    elif fraction > response.dead + 1e-9:
        inside = (fraction - response.dead) / (1.0 - response.dead)
        assert made == pytest.approx(inside**response.curve, rel=1e-4, abs=1e-6)


@given(RATES, AXES, st.floats(1e-3, 1e3))
def test_each_axis_of_an_output_has_the_motion_of_its_own_letter_times_the_gain(w, axes, gain):
    motion = dict(zip("xyz", w, strict=True)) | {"0": 0.0}
    expected = [gain * (-motion[name[1:]] if name[0] == "-" else motion[name]) for name in axes]
    response = Response(gain=gain, axes="".join(axes))
    made = np.array(response.to_axes(w.tolist())) * response.factor(float(np.linalg.norm(w)))
    assert made == pytest.approx(expected, rel=1e-12, abs=1e-12)


@given(RATES, RATES, st.sampled_from(["far-side", "left"]))
def test_axes_of_cam_do_not_depend_on_the_camera_pose(w, turn, player):
    """A rotation about the axes of the camera moves as one about `obj` does with a camera that is not turned."""
    assume(np.linalg.norm(w) > 1e-3)
    R_obj_view, settings = Rotation.from_rotvec(turn), MotionSettings(player=player, scale_y=2.0, invert_x=True)
    pose = Pose(R_obj_view.as_matrix() * (1.0, -1.0, -1.0), np.zeros(3))
    straight = rolling(w, settings)
    turned = rolling(R_obj_view.apply(w), settings, seen=lambda estimate: Sample(estimate, camera=pose))
    made = OutputCounter(Response(in_camera=True)).apply(turned).rate
    assert made == pytest.approx(straight.rate, rel=1e-9, abs=1e-6)
    assert pointer_rate(turned, Response(in_camera=True)) == pytest.approx(
        pointer_rate(straight, Response()), rel=1e-9, abs=1e-9
    )


@given(RESPONSES, st.floats(0.1, 20.0), st.integers(1, 100_000))
def test_counts_and_deflections_have_the_same_curve(response, speed, counts):
    """Over a second, a mouse at a steady speed makes the counts of its deflection times those of full speed."""
    assume(abs(np.degrees(speed) / response.full - response.dead) > 1e-6)
    report = rolling([0.0, speed, 0.0])._replace(counts=(0, 0, counts))
    (deflection,) = response.deflection([speed])
    assume(deflection < 1.0)
    at_full = counts * np.radians(response.full) / speed
    made = OutputCounter(response).apply(report).counts
    assert made == (0, 0, pytest.approx(deflection * at_full, rel=1e-9, abs=1.0))


def test_a_ball_in_the_dead_zone_moves_no_mouse_and_a_plain_output_gets_the_report_itself():
    report = rolling([0.0, np.radians(8.9), 0.0])._replace(counts=(5, 6, 7))
    made = OutputCounter(Response(dead=0.05)).apply(report)
    assert (made.counts, made.rate) == ((0, 0, 0), (0.0, 0.0, 0.0))
    assert OutputCounter(COUNTS_RESPONSE).apply(report) is report
    assert OutputCounter(Response(dead=0.05)).apply(Report((1, 2, 3), None, 0.0)).rate is None


@pytest.mark.parametrize(
    ("spec", "place", "response"),
    [
        ("text:-,gain=2", "text:-", Response(gain=2.0)),
        ("uinput:gain=0.5,third=wheel,axes=y-x0", "uinput:third=wheel", Response(gain=0.5, axes="y-x0")),
        ("null:dead=0.1,curve=1.5,full=90", "null", Response(dead=0.1, curve=1.5, full=90.0)),
        ("serial:auto", "serial:auto", COUNTS_RESPONSE),
        ("gamepad:gain=2", "gamepad:gain=2", COUNTS_RESPONSE),
        ("null:axes=cam:y0x", "null", Response(axes="y0x", in_camera=True)),
    ],
)
def test_every_output_has_the_options_and_one_that_sends_rates_reads_them_itself(spec, place, response):
    assert (full_spec(spec), response_of(spec)) == (place, response)


@pytest.mark.parametrize(
    ("option", "problem"),
    [
        ("gain=0", "gain must be 0.001 to 1000, is 0"),
        ("gain=nan", "gain must be 0.001 to 1000, is nan"),
        ("full=0", "full must be 1 to 10000, is 0"),
        ("full=nan", "full must be 1 to 10000, is nan"),
        ("dead=1", "dead must be 0 to 0.9, is 1"),
        ("curve=-1", "curve must be 0.2 to 5, is -1"),
        ("curve=a", "curve must be a number, is 'a'"),
        ("deed=0", "unknown key deed; did you mean dead?"),
        ("axes=xy", "axes must be three of x, y, z and 0, is 'xy'; write for example axes=x-yz, or axes=cam:xyz"),
        ("axes=x--yz", "axes must be three of x, y, z and 0, is 'x--yz'; write for example axes=x-yz, or axes=cam:xyz"),
        ("dead=0,dead=0", "dead is given twice; leave one out"),
    ],
)
@pytest.mark.parametrize("kind", ["gamepad", "uinput"])
def test_bad_options(kind, option, problem):
    assert refused(f"{kind}:{option}") == f"{kind}:{option}: {problem}"
