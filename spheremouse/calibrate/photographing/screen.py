"""What a person before the camera sees and hears: the last frame in words, what to do, and a tone for every photo."""

import array
import io
import math
import shutil
import subprocess
import sys
import wave
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from spheremouse.calibrate.photographing.look import Judge, Look

_RATE = 16_000  # samples per second
_TONE = 0.12  # s each
TAKEN, ENOUGH = (880.0,), (660.0, 880.0, 1100.0)  # Hz
_PLAYER = "aplay"  # of alsa-utils; reads what it plays from its standard input


class Screen:
    """On a terminal a picture that is drawn anew, elsewhere lines; a context manager."""

    def __init__(self, heard: bool, console: Console | None = None) -> None:
        """`heard`: with a tone for every photo."""
        self._console = console or Console(stderr=True, highlight=False, soft_wrap=True)
        if not self._console.is_terminal:
            self._console.width = 1000
        self._live = Live(console=self._console, transient=True) if self._console.is_terminal else None
        self._heard = heard
        self._told = ""

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.__exit__(kind, error, trace)

    def say(self, text: str) -> None:
        """A line that stays."""
        self._console.print(Text(text))

    def show(self, judge: Judge, look: Look) -> None:
        """The last frame; where there is no terminal, what is wanted when that changes."""
        wanted = judge.wanted()
        if self._live is not None:
            self._live.update(_picture(judge, look, wanted))
        elif look.gain and wanted and wanted[0] != self._told:
            self._told = wanted[0]
            self.say(f"wanted: {wanted[0]}")

    def taken(self, path: Path, judge: Judge, look: Look) -> None:
        """A photo."""
        self.say(f"{path.name}: {look.gain} ({judge.count} photo{'' if judge.count == 1 else 's'})")
        self.ring(TAKEN)

    def ring(self, tones: Sequence[float]) -> None:
        """The terminal's bell, and tones where something can play them."""
        if not self._heard:
            return
        if self._live is not None:
            self._console.bell()
        if player := shutil.which(_PLAYER):
            with suppress(OSError):
                quiet = subprocess.DEVNULL
                playing = subprocess.Popen([player, "-q", "-"], stdin=subprocess.PIPE, stdout=quiet, stderr=quiet)
                if playing.stdin is not None:
                    playing.stdin.write(melody(tones))
                    playing.stdin.close()


def melody(tones: Sequence[float]) -> bytes:
    """Tones, Hz, one after the other as a WAV file."""
    n = round(_RATE * _TONE)
    samples = array.array("h")
    for tone in tones:  # each swells and fades: an edge would click
        samples.extend(
            round(9000 * math.sin(math.pi * k / n) * math.sin(2.0 * math.pi * tone * k / _RATE)) for k in range(n)
        )
    if sys.byteorder == "big":
        samples.byteswap()
    file = io.BytesIO()
    with wave.open(file, "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(_RATE)
        sound.writeframes(samples.tobytes())
    return file.getvalue()


def _picture(judge: Judge, look: Look, wanted: Sequence[str]) -> Text:
    text = Text("\n".join(judge.status()) + "\n")
    text.append(look.words + "\n", "green" if look.gain else "yellow")
    if wanted:
        text.append(f"Next: {wanted[0]}\n", "bold")
    text.append("A photo is taken by itself when the picture is sharp, still and new. Ctrl-C ends.", "dim")
    return text
