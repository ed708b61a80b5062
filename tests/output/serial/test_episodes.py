"""Episodes of a line and a board that do everything they may, one after the other: the books are right at their end."""

import avr_board
import pytest
from serial_episodes import Kind, cost, play, verdict
from serial_world import Board

from spheremouse.output.serial import link as host


class AvrBoard:
    """The ATmega32U4's protocol, with a reset button."""

    def __init__(self):
        self._code, self._before = avr_board.build(), (0, 0, 0, 0)
        self.reset()

    @property
    def moved(self):
        return [a + b for a, b in zip(self._before, self._board.moved, strict=True)]

    def reset(self):
        if hasattr(self, "_board"):
            self._before = self.moved
        self._board = avr_board.Board(self._code)
        self._board.multipliers(0b0101)

    def turn(self, data, now):
        return self._board.turn(data, now)


BOARDS = {"pico": Board, "avr": AvrBoard}


@pytest.mark.parametrize("board", BOARDS)
@pytest.mark.parametrize("speed", [12, 1200])
def test_a_reset_costs_no_more_than_600_counts_and_what_may_be_wrong_is_told(board, speed):
    """Also where the ball turns round while answers are under way, which is where it cost 1200, half of it untold."""
    for seed in range(12):
        world = play(seed, Kind(speed=speed), BOARDS[board]())
        assert verdict(world) == "", f"seed {seed}"
        assert cost(world) <= 600 * world.resets, f"seed {seed}"
        assert max(world.link.uncertain) <= 600 * world.resets
        assert host.STEP == 2 * 600


@pytest.mark.parametrize("board", BOARDS)
def test_old_frames_that_come_again_move_nothing_in_the_end(board):
    """No line does it; a HELLO from before then begins a session in which the board obeys what belongs to another."""
    for seed in (158, 195, *range(10)):
        world = play(seed, Kind(resets=False, replay=True), BOARDS[board]())
        assert verdict(world) == "", f"seed {seed}"
