"""Drawing of a view on a terminal that may be stopped or gone, its keys, and its orderly end.

Messages are lines on standard error; a terminal that is stopped takes none.
"""

import asyncio
import functools
import os
import re
import signal
import sys
import termios
import tty
from collections.abc import Callable, Coroutine, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from math import isfinite
from types import FrameType
from typing import Any, NoReturn

from rich.console import Console
from rich.layout import Layout
from rich.live import Live

from adaptdrive.mqtt.commands import STOP, number, part
from adaptdrive.tui.record import WatchRecord
from adaptdrive.util.clock import in_thread
from adaptdrive.util.errors import ConfigurationError

# The end of a view that commands a drive: once it is asked for, nothing cuts it short.

LONGEST_S = 1.0
"""Longest wait for a terminal to take what is written last."""

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def ended_once() -> Iterator[None]:
    """Cancel the present task at the first signal that ends a program, and ignore all later ones.

    A signal that the process was started to ignore stays ignored.

    Raises:
        KeyboardInterrupt: A signal came, and the task has ended by it.
    """
    task, loop = asyncio.current_task(), asyncio.get_running_loop()
    assert task is not None  # noqa: S101 - a view runs in a task
    asked = False

    def end(_number: int, _frame: FrameType | None) -> None:
        nonlocal asked
        if not asked:
            asked = True
            task.cancel()
            loop.call_soon_threadsafe(lambda: None)  # the loop may be asleep

    heeded = [one for one in _ENDING if signal.getsignal(one) is not signal.SIG_IGN]
    usual = {one: signal.signal(one, end) for one in heeded}
    try:
        yield
    except asyncio.CancelledError:
        if asked:
            raise KeyboardInterrupt from None
        raise
    finally:
        for one, handler in usual.items():
            signal.signal(one, handler)


async def whole(work: Coroutine[Any, Any, None], *, complete: bool) -> None:
    """Await work that no cancellation interrupts.

    Args:
        work: What is awaited.
        complete: Whether a cancellation counts for nothing; else it counts when the work is done.

    Raises:
        CancelledError: The present task was cancelled meanwhile.
    """
    task, cancelled = asyncio.create_task(work), False
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError:
            cancelled = True
    if cancelled and not complete:
        raise asyncio.CancelledError
    task.result()


def print_line(text: str) -> Future[None]:
    """Write a line, in a thread that may hang."""
    return in_thread(functools.partial(_ending_write, f"{text}\n"), "adaptdrive-line")


def print_last(text: str) -> None:
    """Write lines before the process ends, unless the terminal is gone or takes none."""
    with suppress(OSError, TimeoutError):
        print_line(text).result(LONGEST_S)


def _ending_write(text: str) -> None:
    """Write to a separate descriptor: at its end Python waits for a stream that is in use."""
    encoding, errors = sys.stderr.encoding, sys.stderr.errors
    with os.fdopen(os.dup(sys.stderr.fileno()), "w", encoding=encoding, errors=errors) as output:
        output.write(text)


# Drawing of a view on a terminal, which may be stopped or gone.

REFRESH_S = 0.25


def refuse_dumb_terminal() -> None:
    """Refuse a terminal in which the cursor cannot be moved.

    Raises:
        ConfigurationError: The environment names such a terminal.
    """
    if Console(force_terminal=True).is_dumb_terminal:
        kind = os.environ["TERM"]
        raise ConfigurationError.of("TERM", kind, "a terminal of this kind shows no picture")


async def draw(screen_of: Callable[[tuple[int, int]], Layout]) -> NoReturn:
    """Fill the terminal four times a second, until cancelled.

    A terminal that takes no output, such as one that is stopped or behind a lost connection, holds
    up nothing but its picture: a thread writes to it.

    Args:
        screen_of: Returns the screen for a terminal of some width and height, in characters.

    Raises:
        ConfigurationError: The terminal shows no picture.
    """
    refuse_dumb_terminal()
    # one column for each letter that the terminal does not have, too
    output = os.fdopen(
        os.dup(sys.stdout.fileno()), "w", encoding=sys.stdout.encoding, errors="replace"
    )
    console = Console(file=output, force_terminal=True)
    live = Live(
        console=console,
        screen=True,
        auto_refresh=False,
        redirect_stdout=False,
        redirect_stderr=False,
    )
    try:
        await _write(live.start)
        while True:
            shown = screen_of((console.size.width, console.size.height))
            await _write(functools.partial(live.update, shown, refresh=True))
            await asyncio.sleep(REFRESH_S)
    finally:
        with suppress(TimeoutError, OSError):
            await asyncio.wait_for(_write(live.stop), LONGEST_S)
            output.close()


def _write(call: Callable[[], None]) -> asyncio.Future[None]:
    """Write to the terminal, in a thread that may hang."""
    return asyncio.wrap_future(in_thread(call, "adaptdrive-screen"))


# Keys of the live view, and the commands that they send.

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
        unit: Its unit, None for that of the drive.
        disturbance: Request to a simulated device, None for a command of the drive.
    """

    verb: str
    value: object = None
    disturbance: Mapping[str, Any] | None = None
    unit: str | None = None

    @property
    def text(self) -> str:
        """The command in words."""
        return " ".join(str(one) for one in (self.verb, self.value, self.unit) if one is not None)

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
        if not isfinite(wanted):
            return None
        display = self._record.display
        level = display.shown(min(max(wanted, low), high))
        return KeyCommand("setpoint", level, unit=display.mark)


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
    # Ctrl-Z: after `fg` the shell has the keys wait for an Enter
    settings[6][termios.VSUSP] = b"\0"
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
