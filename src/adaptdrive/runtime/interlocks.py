"""Interlocks: what must hold while the drive is energised, and the last look at a command.

Each check gives the cause of a trip in words, or None. A trip is latched by the state machine;
`reset` is refused while a cause is still there.

A lost or disturbed frame now and then is what the age of the values is for. A large share of them
for long is a mistake in the configuration, a second sender or a bad cable. It can go unnoticed:
where every other frame is refused, no value ever grows old.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from adaptdrive.config.bus import MEASURED
from adaptdrive.control.loads.load import to_input
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.faults import describe_fault
from adaptdrive.devices.port import Reading
from adaptdrive.runtime.reports import DriveReport
from adaptdrive.util.quantity import BOOST, Given

# Interlocks: what must hold while the drive is energised.

# Interlocks: what must hold while the drive is energised.


@dataclass(frozen=True, slots=True)
class Limits:
    """Trip levels.

    Attributes:
        boost_voltage_max_V: Over-voltage.
        output_max: Highest output.
        output_unit: Unit of the output, for the text of the trip.
        output_name: Name of the output, as above.
        output_min: Lowest output.
        absent: Quantities that nobody measures.
        given: Name and unit of what the drive gives, for the text of the trip.
    """

    boost_voltage_max_V: float
    output_max: float
    output_unit: str
    output_name: str = "output"
    output_min: float = -math.inf
    absent: frozenset[str] = frozenset()
    given: Given = BOOST


@dataclass(frozen=True, slots=True)
class OutputModel:
    """Model of the load by which a watch judges its output.

    Attributes:
        output_unit: Unit of the output, for the text of the trip.
        gain: Change of the output at rest per unit of the input.
        input_gain: u = gain · v_bst^exponent.
        input_exponent: 1 or 2.
        lags_s: Time constants between input and output.
        output_name: Name of the output, as above.
        factor: Multiple of a lag with which a stage may rise, and part of it with which it may
            fall.
        by_power: Whether the input is the power over the boost voltage, and stores nothing.
    """

    output_unit: str
    gain: float
    input_gain: float
    input_exponent: int
    lags_s: tuple[float, ...]
    output_name: str = field(default="output", kw_only=True)
    factor: float = field(default=1.0, kw_only=True)
    by_power: bool = field(default=False, kw_only=True)

    def input(self, reading: Reading) -> float:
        """Return the input u at a reading."""
        if self.by_power:
            return reading.load_power_W / max(reading.boost_voltage_V, 1.0)
        return to_input(reading.boost_voltage_V, self.input_gain, self.input_exponent)

    def pass_on(self, stages: list[float], level: float, period_s: float) -> float:
        """Pass a level through the chain of lags; return the lowest that may come out of it.

        Args:
            stages: Output of each lag; overwritten.
            level: Input of the first one.
            period_s: Time for which it has been there.
        """
        falls = 0.0 if self.by_power else 1.0 / self.factor
        for number, lag_s in enumerate(self.lags_s):
            stage = stages[number]
            slow_s = lag_s * (self.factor if level > stage else falls)
            if slow_s > 0.0:
                level = stage - (level - stage) * math.expm1(-period_s / slow_s)
            stages[number] = level
        return level


class Watch(Protocol):
    """Compares the readings of a running drive with each other, one after the other."""

    def forget(self) -> None:
        """Begin anew: the drive is not running."""

    def find_cause(self, reading: Reading) -> str | None:
        """Return the cause of a trip, None for none.

        Args:
            reading: The newest, again where there is no newer one.
        """


def find_cause(
    reading: Reading | None,
    now_s: float,
    limits: Limits,
    stale_s: float,
    explain_age: Callable[[], str] = str,
) -> str | None:
    """The first reason why the drive must not be energised, None when there is none.

    Args:
        reading: The latest reading, None before the first.
        now_s: Monotonic time.
        limits: Trip levels.
        stale_s: Oldest usable measurement.
        explain_age: Names the oldest value and why it is old; called for a stale reading alone.
    """
    if reading is None:
        return f"stale: no measurement yet{_reason(explain_age())}"
    age_s = now_s - reading.oldest_s
    limit_s = stale_s + reading.slack_s
    if not age_s <= limit_s:
        return (
            f"stale: measurement is {age_s * 1e3:.0f} ms old, limit {limit_s * 1e3:g} ms"
            f"{_reason(explain_age())}"
        )
    return _unhealthy(reading, limits.absent) or _exceeded(reading, limits)


def _reason(text: str) -> str:
    return f"; {text}" if text else ""


def _unhealthy(reading: Reading, absent: frozenset[str]) -> str | None:
    name = _not_finite(reading, absent)
    if name is not None:
        return (
            f"invalid: {name} = {getattr(reading, name)} is not a finite number: look at its "
            "sensor, its scale and offset, and at [derived]"
        )
    if reading.fault:
        return describe_fault(reading.fault, reading.fault_name)
    return None


def _exceeded(reading: Reading, limits: Limits) -> str | None:
    if abs(reading.boost_voltage_V) > limits.boost_voltage_max_V:
        given = limits.given
        return (
            f"{'over-voltage' if given.is_boost_voltage else 'drive above its limit'}: "
            f"{given.name} = {given.text(reading.boost_voltage_V, '.1f')}, limit "
            f"{given.text(limits.boost_voltage_max_V, 'g')}"
        )
    if reading.output > limits.output_max:
        values = _compared(reading.output, limits.output_max, limits)
        return f"output above its limit: {values}: look for a lost load, or at the sensor"
    if reading.output < limits.output_min:
        values = _compared(reading.output, limits.output_min, limits)
        return f"output below its limit: {values}: is the sensor reversed, or its wire broken?"
    return None


def _compared(output: float, limit: float, limits: Limits) -> str:
    unit = f" {limits.output_unit}" if limits.output_unit else ""
    return f"{limits.output_name} = {output:.4g}{unit}, limit {limit:g}{unit}"


def _not_finite(reading: Reading, absent: frozenset[str]) -> str | None:
    """The name of the first measured quantity that is not a finite number."""
    if (
        math.isfinite(reading.boost_voltage_V)
        and math.isfinite(reading.line_voltage_V)
        and math.isfinite(reading.load_power_W)
        and math.isfinite(reading.output)
    ):
        return None
    odd = (name for name in MEASURED if not math.isfinite(getattr(reading, name)))
    return next((name for name in odd if name not in absent), None)


# The share of its frames that a port has to refuse, over a window of time.

WINDOW_S = 5.0
"""Longer than a burst of noise, shorter than the time to damage a load."""

_LEAST_FRAMES = 20
"""Frames in a window from which on a share is judged: one of them is half of the share noted."""

_NOTED_SHARE = 0.1
"""Share that is reported; a bus in order refuses less than one frame in a thousand."""

_FORGOTTEN_SHARE = 0.05
"""Share below which the next one is reported again."""

_CAUSES = {
    "wrong_checksum": "is data_id, data_id_mode or the algorithm of [bus.integrity] another one, "
    "does a second sender use the id, or is the cable disturbed?",
    "wrong_length": "does the DBC, the EDS or the register map describe another version?",
    "counter_stuck": "does the sender hang, or does a gateway repeat its frames?",
    "out_of_range": "is a scale, an offset or a range wrong, or a sensor broken?",
    "exceptions": "does the device have these registers, and does it take commands (remote mode)?",
    "timeouts": "are the baud rate, the device id and the cable right, and the time-out long "
    "enough?",
}


class RefusedShares:
    """Measures the shares of the drive's port and of the separate sensor buses."""

    def __init__(self, limit: float) -> None:
        """Start without a count.

        Args:
            limit: Share that must not be reached while the drive is energised, 0 for any.
        """
        self._limit = limit
        self._ports: dict[str, RefusedShare] = {}

    def add(self, books: DriveReport) -> list[str]:
        """Take the counts of every port, and return what is to be reported."""
        ports = {"drive": books.bus} | {one.name: one.bus for one in books.sensors}
        found = [self._port(name).add(books.time_s, counts) for name, counts in ports.items()]
        return [text for text in found if text is not None]

    @property
    def cause(self) -> str | None:
        """Reason not to energise the drive, None for no reason."""
        causes = (port.cause for port in self._ports.values())
        return next((cause for cause in causes if cause is not None), None)

    def _port(self, name: str) -> RefusedShare:
        return self._ports.setdefault(name, RefusedShare(name, self._limit))


class RefusedShare:
    """Measures the share of one port."""

    def __init__(self, name: str, limit: float) -> None:
        """Start without a count.

        Args:
            name: Name of the port in reports.
            limit: Share that must not be reached while the drive is energised, 0 for any.
        """
        self._name = name
        self._limit = limit
        self._marks: deque[tuple[float, Mapping[str, int]]] = deque()
        self._noted = False
        self.cause: str | None = None

    def add(self, now_s: float, counts: Mapping[str, int]) -> str | None:
        """Take the counts of the port, and judge its share anew.

        Args:
            now_s: Monotonic time.
            counts: Its statistics by name.

        Returns:
            What is to be reported, None for nothing new.
        """
        marks = self._marks
        marks.append((now_s, counts))
        while len(marks) > 1 and now_s - marks[1][0] >= WINDOW_S:
            marks.popleft()
        since_s, first = marks[0]
        grown = {name: counts[name] - first[name] for name in counts}
        judged = _judged(grown)
        if now_s - since_s < WINDOW_S or judged < _LEAST_FRAMES:
            self.cause = None
            return None
        refused = _refused(grown)
        share = min(1.0, sum(refused.values()) / judged)
        text = self._text(share, judged, refused)
        trips = self._limit and share >= self._limit
        self.cause = f"refused frames: {text}, limit {self._limit:.0%}" if trips else None
        noted, least = self._noted, _FORGOTTEN_SHARE if self._noted else _NOTED_SHARE
        self._noted = share >= least
        return text if self._noted and not noted else None

    def _text(self, share: float, judged: int, refused: Mapping[str, int]) -> str:
        reason = max(refused, key=lambda name: refused[name])
        return (
            f"{self._name}: {share:.0%} of the last {judged} frames were refused, most for "
            f"{reason} ({refused[reason]}): {_CAUSES[reason]} `adaptdrive probe` shows them"
        )


def _judged(grown: Mapping[str, int]) -> int:
    """Return the frames that were meant for this port; for one that polls, its requests.

    A port that receives nothing refuses nothing: its values age.
    """
    asked = grown["exceptions"] + grown["timeouts"]
    if not asked:
        return grown["received"] - grown["foreign"]
    heard = grown["received"] + grown["exceptions"]
    return heard + grown["timeouts"] if heard else 0


def _refused(grown: Mapping[str, int]) -> dict[str, int]:
    """Return the frames that were refused, by reason."""
    refused = {name: grown[name] for name in _CAUSES}
    # a disturbed reply on a serial line is a missing one, too
    disturbed = refused["wrong_checksum"] + refused["wrong_length"]
    refused["timeouts"] = max(0, refused["timeouts"] - disturbed)
    return refused


# The last look at a command before the wire: finite, in range, not jumping.


@dataclass(frozen=True, slots=True)
class CommandLimits:
    """Limits of commands.

    Attributes:
        current_scale_min_S: Lowest k.
        current_scale_max_S: Highest k.
        current_scale_slew_S: Largest change of k from one tick to the next.
        boost_reference_max_V: Highest V_c.
        boost_reference_min_V: Lowest V_c where that is negative; else 0, the safe command's.
        given: Name and unit of V_c, for texts.
    """

    current_scale_min_S: float
    current_scale_max_S: float
    current_scale_slew_S: float
    boost_reference_max_V: float
    boost_reference_min_V: float = 0.0
    given: Given = BOOST


class Guard:
    """Holds every command to its limits and counts what it had to change.

    Attributes:
        limited: Commands that were held to a limit.
    """

    def __init__(self, limits: CommandLimits) -> None:
        self._limits = limits
        self._last_scale_S = 0.0
        self.limited = 0

    def check(self, command: Command) -> Command:
        """Return the command to send: the given one wherever it is within limits.

        Raises:
            ValueError: A value is not finite.
        """
        scale_S, reference_V = command.current_scale_S, command.boost_reference_V
        if not (math.isfinite(scale_S) and math.isfinite(reference_V)):
            given = self._limits.given
            raise ValueError(
                f"the controller gave k = {scale_S:g} S, {given.symbol} = "
                f"{given.text(reference_V, 'g')}, which is not finite; keep the session "
                "for a report, then reset"
            )
        if not (command.bridge or scale_S or reference_V):
            self._last_scale_S = 0.0
            return SAFE_COMMAND
        limits, last_S = self._limits, self._last_scale_S
        low_S = max(limits.current_scale_min_S, last_S - limits.current_scale_slew_S)
        high_S = min(limits.current_scale_max_S, last_S + limits.current_scale_slew_S)
        self._last_scale_S = min(max(scale_S, low_S), high_S)
        lowest_V = min(limits.boost_reference_min_V, 0.0)
        limited_V = min(max(reference_V, lowest_V), limits.boost_reference_max_V)
        if self._last_scale_S == scale_S and limited_V == reference_V:
            return command
        self.limited += 1
        return Command(self._last_scale_S, limited_V, command.bridge)
