"""Keys of the live view, and the commands that they send."""

from __future__ import annotations

import asyncio
import os
import re
import sys
import termios
import tty
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from math import isfinite
from typing import Any

from adaptdrive.mqtt.commands import STOP, number, part
from adaptdrive.tui.record import WatchRecord

QUIT = "q"
CONFIRM_S = 5.0
"""Time for the second press of a key that energises."""

DELIBERATE_S = 0.8
"""Shortest time to the second press: a key that is held repeats itself after 0.25 to 0.66 s."""

_LONGEST_READ = 64
_NAMED_KEY = re.compile(r"\x1b(?:[NO].|\[[0-?]*[ -/]*[@-~])")
"""Sequence of a terminal for a key without a letter (ECMA-48), such as ESC O S for F4."""

_STEP = 0.01
_STEPS = {"+": 1, "-": -1}


@dataclass(frozen=True, slots=True)
class KeyCommand:
    """A command that a key asks for.

    Attributes:
        verb: Verb of the command, or the words of a disturbance.
        value: Value of the command.
        disturbance: Request to a simulated device, None for a command of the drive.
    """

    verb: str
    value: object = None
    disturbance: Mapping[str, Any] | None = None

    @property
    def text(self) -> str:
        """The command in words."""
        return self.verb if self.value is None else f"{self.verb} {self.value}"

    @property
    def stops(self) -> bool:
        """True for the command that stops the drive."""
        return self.verb == STOP and self.disturbance is None


_COMMANDS = {
    **dict.fromkeys("sS", KeyCommand(STOP)),
    "r": KeyCommand("reset"),
    **{mode[0]: KeyCommand("mode", mode) for mode in ("fixed", "adaptive", "manual")},
}


class KeyReader:
    """Turns keys into commands; `enable` needs a second press."""

    def __init__(self, record: WatchRecord) -> None:
        self._record = record
        self._armed_s: float | None = None

    def press(self, key: str, *, alone: bool = True) -> KeyCommand | None:
        """Return the command of a key, None for none.

        Args:
            key: The key.
            alone: False where other keys came with it, as from a clipboard: it confirms nothing.
        """
        armed_s, self._armed_s = self._armed_s, None
        if key in _COMMANDS:
            return _COMMANDS[key]
        if key in _STEPS:
            return self._step(_STEPS[key])
        if key == "e":
            return self._enable(armed_s, alone=alone)
        return self._disturbance(key)

    def _disturbance(self, key: str) -> KeyCommand | None:
        """Return the disturbance that a simulated device offers under a digit."""
        features = self._record.features
        if key not in "123456789" or int(key) > len(features):
            return None
        chosen = features[int(key) - 1]
        return KeyCommand(str(chosen.get("text")), disturbance=chosen["request"])

    def _enable(self, armed_s: float | None, *, alone: bool) -> KeyCommand | None:
        """Return the command for the second of two separate presses; each other one is a first."""
        now_s = self._record.monotonic()
        if alone and armed_s is not None and DELIBERATE_S <= now_s - armed_s <= CONFIRM_S:
            return KeyCommand("enable")
        self._armed_s = now_s
        self._record.answer = "enable: press e again after a second"
        return None

    def _step(self, sign: int) -> KeyCommand | None:
        """Return a set-point that is one hundredth of the range away, within the range.

        During a waveform there is none: the set-point of the state is the one of before it, which
        the load may have left by the whole range.
        """
        if self._record.state.get("waveform") is not None:
            self._record.answer = "set-point: a waveform runs; + and - move a constant set-point"
            return None
        limits = part(self._record.state, "limits").get("setpoint")
        if not isinstance(limits, list) or len(limits) != 2:
            return None
        low, high = map(number, limits)
        wanted = number(self._record.state.get("setpoint")) + sign * _STEP * (high - low)
        return KeyCommand("setpoint", min(max(wanted, low), high)) if isfinite(wanted) else None


@contextmanager
def pressed_keys(on_keys: Callable[[str], None]) -> Iterator[None]:
    """Call a function with the keys that are pressed, until the block ends.

    Args:
        on_keys: Called in the event loop with a character for each key that came in one read.
    """
    loop, file = asyncio.get_running_loop(), sys.stdin.fileno()
    usual = termios.tcgetattr(file)
    tty.setcbreak(file, termios.TCSANOW)
    settings = termios.tcgetattr(file)
    settings[6][termios.VSUSP] = (
        b"\0"  # Ctrl-Z: after `fg` the shell has the keys wait for an Enter
    )
    termios.tcsetattr(file, termios.TCSANOW, settings)

    def read() -> None:
        keys = b""
        with suppress(OSError):
            keys = os.read(file, _LONGEST_READ)
        if not keys:  # the terminal is gone
            loop.remove_reader(file)
            on_keys(QUIT)
        else:
            on_keys(_NAMED_KEY.sub("", keys.decode(errors="ignore")))

    loop.add_reader(file, read)
    try:
        yield
    finally:
        loop.remove_reader(file)
        with suppress(termios.error):
            termios.tcsetattr(file, termios.TCSANOW, usual)  # no wait for what was written
