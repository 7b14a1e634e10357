"""A running drive as an object, for a shell and for notebooks: values are attributes that age."""

from __future__ import annotations

import asyncio
import math
import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime
from functools import partial
from html import escape
from typing import Any, Self

from adaptdrive.mqtt import commands
from adaptdrive.mqtt.client import LIVE_S, NoAnswerError, follow, send_command
from adaptdrive.mqtt.connection import Broker
from adaptdrive.mqtt.contract import ONLINE, Reply
from adaptdrive.runtime.reports import SLOW_COLUMNS, TICK_COLUMNS
from adaptdrive.runtime.requests import REQUESTS
from adaptdrive.safety.trips import kind_of, remedy
from adaptdrive.util.clock import in_thread
from adaptdrive.util.errors import RefusedError
from adaptdrive.util.quantity import Display

# What a drive has published: values by name, each with its unit, for as long as they are fresh.

_TOPICS = {"telemetry/drive": "drive", "state": "state", "telemetry/load": "load"}

_UNITS = {one.name: one.unit for one in (*TICK_COLUMNS, *SLOW_COLUMNS)} | {
    "setpoint": "y",
    "voltage_V": "v",
    "age_s": "s",
}
_DIFFERENCES = {"resolution", "rounding", "innovation", "probe"}
_SLOW = {one.name for one in SLOW_COLUMNS}
_SLOW_PERIODS = 3.0
"""Age in slow periods up to which the values of the last one are fresh."""

_SHOWN = 3000
"""Measurements that a live plot shows: five minutes."""


class Value(float):
    """A number with its unit, and its standard deviation where it is an estimate.

    Attributes:
        unit: Its unit, empty for a plain number.
        std: Its standard deviation, NaN where there is none.
    """

    unit: str
    std: float

    def __new__(cls, number: float, unit: str = "", std: float = math.nan) -> Self:
        """Make one."""
        made = super().__new__(cls, number)
        made.unit, made.std = unit, std
        return made

    def __repr__(self) -> str:
        doubt = f" ± {self.std:.2g}" if math.isfinite(self.std) else ""
        return f"{float(self):.6g}{doubt} {self.unit}".rstrip()

    __str__ = __repr__


class Published:
    """The last messages of a drive.

    A value has the name of its field. One that is asked for by a command of the same name is called
    `setpoint_asked`; of two of one name that of the slow period is called `output_load`.

    Attributes:
        problem: Why the broker was last lost, empty while it is there.
        course: Time of arrival, output and reference of the last measurements.
    """

    def __init__(self, drive: str, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin with nothing.

        Args:
            drive: Name of the drive.
            clock: In s.
        """
        self.problem = ""
        self.course: deque[tuple[float, float, float]] = deque(maxlen=_SHOWN)
        self._drive, self._clock = drive, clock
        self._online: bool | None = None
        self._arrived_s = -math.inf
        self._parts: dict[str, dict[str, Any]] = {}

    def take(self, topic: str, content: dict[str, Any]) -> None:
        """Note a message, by the name of its topic as `follow` yields it."""
        if topic == "availability":
            self._online = content[topic] == ONLINE.decode()
        elif topic in _TOPICS:
            self._parts = self._parts | {_TOPICS[topic]: content}
        if topic == "telemetry/drive":
            self._arrived_s = self._clock()
            found = content.get("output"), self._parts.get("load", {}).get("reference")
            output, reference = (self.display.shown(commands.number(one)) for one in found)
            self.course.append((self._arrived_s, output, reference))

    @property
    def display(self) -> Display:
        """Unit in which people see and type the output."""
        return commands.display_in(self._parts.get("state", {}))

    @property
    def names(self) -> list[str]:
        """Names of all values that are fresh."""
        places = _places(self._parts)
        return [name for name, (part, _) in places.items() if not self.flaw(part)]

    def value(self, name: str) -> Any:  # noqa: ANN401 - numbers, texts and what contains them
        """Return a value.

        Raises:
            NoAnswerError: It is of an earlier time, or the first one is still to come.
            KeyError: There is none of that name.
        """
        places = _places(self._parts)
        if name not in places and name.removesuffix("_load") in _SLOW and not self.flaw():
            raise NoAnswerError(self._drive, f"{name}: no slow period has passed yet")
        part, key = places[name]
        if flaw := self.flaw(part):
            raise NoAnswerError(self._drive, flaw)
        return self._read(self._parts[part], key)

    def flaw(self, part: str = "drive") -> str:
        """Return why the values of a part are not fresh, empty where they are.

        Args:
            part: `drive`, `state` or `load`.
        """
        age_s = self._clock() - self._arrived_s
        if not self._online or age_s > LIVE_S:
            lost = f" ({self.problem})" if self.problem else ""
            old = f"its last telemetry is {age_s:.1f} s old" if age_s < math.inf else "no telemetry"
            since = {True: old, False: "its daemon is offline", None: "no answer"}[self._online]
            return f"{since}{lost}"
        if part == "load":
            behind_s = _time_s(self._parts["drive"]) - _time_s(self._parts["load"])
            period_s = commands.number(self._parts["load"].get("period_s"))
            if not abs(behind_s) <= max(LIVE_S, _SLOW_PERIODS * period_s):
                return f"its last slow period ended {behind_s:.1f} s ago: it does not run"
        return ""

    @property
    def summary(self) -> str:
        """State and output in a few words, or why they are not known."""
        if flaw := self.flaw():
            return flaw
        state, drive = self._parts.get("state", {}), self._parts["drive"]
        words = f"{state.get('trip') or state.get('state')}, {drive.get('output_name')}"
        return f"{commands.printable(words)} {self._read(drive, 'output')!r}"

    def _read(self, content: Mapping[str, Any], key: str) -> Any:  # noqa: ANN401 - as `value`
        found, state = content.get(key), self._parts.get("state", {})
        output = commands.printable(commands.part(state, "output").get("unit") or "")
        units = output, commands.given_in(state).unit
        if key == "estimates":
            found = commands.part(content, key)
            return {name: _estimate(name, found, units) for name in found}
        if key not in _UNITS or not isinstance(found, int | float | None):
            return found
        unit = {"v": units[1], "u": ""}.get(_UNITS[key], _UNITS[key])
        if _UNITS[key] == "y":
            display = self.display.change if key in _DIFFERENCES else self.display
            return Value(display.shown(commands.number(found)), display.unit)
        plain = isinstance(found, bool | int) and not unit
        return found if plain else Value(commands.number(found), unit)


def _places(parts: Mapping[str, Mapping[str, Any]]) -> dict[str, tuple[str, str]]:
    """Return part and field of each value, by its name."""
    found: dict[str, tuple[str, str]] = {}
    for part in _TOPICS.values():
        for key in parts.get(part, ()):
            name = f"{key}_asked" if key in REQUESTS else key
            found[f"{name}_{part}" if name in found else name] = part, key
    return found


def _estimate(name: str, estimates: dict[str, Any], units: tuple[str, str]) -> Value:
    found = commands.part(estimates, name)
    _, unit = commands.quantity_and_unit(name, estimates, *units)
    return Value(commands.number(found.get("value")), unit, commands.number(found.get("std")))


def _time_s(content: Mapping[str, Any]) -> float:
    """Return the time of a message by the clock of its drive, NaN where it has none."""
    try:
        return datetime.fromisoformat(str(content.get("time"))).timestamp()
    except ValueError:
        return math.nan


# The drive: a thread follows what it publishes, and sends what the program commands.

_PAUSE_S = 1.0
_LOOK_S = 0.02


class ConnectedDrive:
    """A running drive: each value of telemetry and state is an attribute, each command a method.

    A value that is no longer fresh raises `NoAnswerError`. A command waits for the reply of the
    drive; it raises `RefusedError` with reason and remedy, or `NoAnswerError`. Its value comes
    first, other fields by their name, as in `drive.voltage(300.0, hold_s=5.0)`. The end of a
    program changes nothing on the drive.
    """

    def __init__(self, name: str, broker: Broker, timeout_s: float) -> None:
        """Connect, and wait for state and telemetry.

        Args:
            name: Name of the drive.
            broker: The broker.
            timeout_s: Longest wait, also for the reply to a command.

        Raises:
            NoAnswerError: The broker or the daemon does not answer.
        """
        self._name, self._broker, self._timeout_s = name, broker, timeout_s
        self._published = Published(name)
        self._loop = asyncio.new_event_loop()
        self._ending, self._pid = asyncio.Event(), os.getpid()
        self._thread = in_thread(self._run, f"drive {name}")
        try:
            self._wait(lambda: not self._published.flaw(), timeout_s)
        except TimeoutError:
            self.close()
            raise NoAnswerError(name, self._published.flaw()) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the connection; the drive goes on as it is."""
        with suppress(RuntimeError):  # it has ended
            self._loop.call_soon_threadsafe(self._ending.set)
        self._thread.result()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - values of any kind, and commands
        if name in REQUESTS:
            command = partial(self.send, name)
            command.__doc__ = REQUESTS[name].__doc__
            return command
        try:
            return self.__dict__["_published"].value(name)
        except KeyError:
            raise AttributeError(f"the drive publishes no {name!r}", name=name, obj=self) from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *REQUESTS, *self._published.names]

    def wait_until(
        self, condition: Callable[[ConnectedDrive], object], timeout_s: float = 60.0
    ) -> None:
        """Wait until a condition holds; values of a slow period may be still to come.

        Args:
            condition: Called with the drive again and again, as
                `lambda d: abs(d.output - 90) < 1`.
            timeout_s: Longest wait.

        Raises:
            TimeoutError: It did not hold in time; the message says what the drive did.
            NoAnswerError: The drive went silent.
        """

        def holds() -> object:
            try:
                return condition(self)
            except NoAnswerError:
                if self._published.flaw():
                    raise
                return False  # a drive that starts has no slow period yet

        self._wait(holds, timeout_s)

    def send(self, verb: str, value: object = None, **fields: object) -> Reply:
        """Send any command.

        Args:
            verb: Its name, as on the command line.
            value: Its value, None for a verb without one.
            fields: Fields of the payload other than the value.

        Raises:
            RefusedError: The drive refused it.
            NoAnswerError: No reply in time, or no broker.
        """
        if self._thread.done() or os.getpid() != self._pid:
            raise NoAnswerError(self._name, "the connection is closed: connect again")
        sending = send_command(self._broker, self._name, verb, value, self._timeout_s, **fields)
        return accepted(asyncio.run_coroutine_threadsafe(sending, self._loop).result())

    def setpoint(self, value: float, slope: float | None = None) -> Reply:
        """Go to a set-point, in the unit that `output` has; `slope` is its change in one second."""
        return self.send("setpoint", value, slope=slope, unit=self._published.display.mark)

    def waveform(
        self, shape: str, low: float, high: float, period_s: float, *, preview: bool = True
    ) -> Reply:
        """Follow a periodic set-point; V_c moves before edges beyond its limits with `preview`."""
        value = {"shape": shape, "low": low, "high": high, "period_s": period_s}
        return self.send("waveform", value, preview=preview, unit=self._published.display.mark)

    def __repr__(self) -> str:
        return f"{self._name}: {self._published.summary}"

    def _repr_html_(self) -> str:
        """Return a table of all values that are fresh, for a notebook."""
        rows = (
            f"<tr><td>{escape(name)}</td><td>{escape(repr(self._published.value(name)))}</td></tr>"
            for name in self._published.names
        )
        return f"<table><caption>{escape(repr(self))}</caption>{''.join(rows)}</table>"

    def live(self, duration_s: float = 60.0) -> None:
        """Draw output and reference in a notebook, once a second, until it is interrupted.

        Args:
            duration_s: Longest time.

        Raises:
            ModuleNotFoundError: A library is not installed: `adaptdrive[analysis,shell]`.
        """
        from IPython.display import DisplayHandle, Image  # noqa: PLC0415 - an extra

        from adaptdrive.analysis.figures import draw_course  # noqa: PLC0415 - an extra

        handle, end_s = DisplayHandle(), time.monotonic() + duration_s
        show: Callable[[object], object] = handle.display
        with suppress(KeyboardInterrupt):
            while time.monotonic() < end_s:
                show(Image(draw_course(list(self._published.course), repr(self))))
                show = handle.update
                time.sleep(1.0)

    def _wait(self, holds: Callable[[], object], timeout_s: float) -> None:
        end_s = time.monotonic() + timeout_s
        while not holds():
            if time.monotonic() > end_s:
                raise TimeoutError(f"not so within {timeout_s:g} s; {self!r}")
            time.sleep(_LOOK_S)

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())  # which leaves the other task to the end of the runner

    async def _serve(self) -> None:
        tasks = [asyncio.create_task(one) for one in (self._follow(), self._ending.wait())]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)

    async def _follow(self) -> None:
        while True:
            try:
                async for topic, content in follow(self._broker, self._name):
                    self._published.problem = ""
                    self._published.take(topic, content)
            except NoAnswerError as problem:  # the values age until the broker is back
                self._published.problem = problem.problem
            await asyncio.sleep(_PAUSE_S)


def accepted(reply: Reply) -> Reply:
    """Return a reply to a command that was carried out.

    Raises:
        RefusedError: It was not; with the remedy of the trip for which it was refused.
    """
    if reply.accepted:
        return reply
    raise RefusedError(reply.reason, reply.trip_kind or "", remedy(kind_of(reply.trip_kind)))
