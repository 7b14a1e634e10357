"""The port that every backend meets: how a reading arrives and a command leaves.

A port decodes frames, stamps them on arrival with the monotonic clock and hands each complete
`Reading` to one listener, from within the event loop: of readings that piled up, the newest alone.
Sending never blocks and never retries: what the bus does not take at once is dropped and counted,
because the next tick brings a fresher command.

Each quantity is judged by itself. A value that must not be used does not replace the last good one
of its quantity: that one keeps its own time and ages.
"""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from adaptdrive.control.signals import Command
from adaptdrive.devices.description import Source
from adaptdrive.safety.facts import FaultLatch, Reading
from adaptdrive.safety.monitor import Monitor
from adaptdrive.safety.trips import Trip

# The port that every backend meets: how a reading arrives and a command leaves.

LAST_STOPS = 3
"""Safe commands at the end: two of them may be lost."""

LAST_STOP_GAP_S = 0.005
"""Time between them, so that one disturbance of the bus does not hit all."""


@dataclass(frozen=True, slots=True)
class PortStatistics:
    """Counts since the port was opened; every refusal of a frame is one of them.

    `foreign_commands` are frames by which another sender commands this drive. `withheld_commands`
    are those that were kept from the drive on purpose: it must report first, or does not obey.
    """

    received: int = 0
    sent: int = 0
    send_drops: int = 0
    withheld_commands: int = 0
    foreign: int = 0
    foreign_commands: int = 0
    wrong_length: int = 0
    wrong_checksum: int = 0
    counter_stuck: int = 0
    counter_lost: int = 0
    out_of_range: int = 0
    timeouts: int = 0
    exceptions: int = 0
    reconnects: int = 0


class Listener(Protocol):
    """Receiver of a port's events. Called in the event loop; must return at once."""

    def on_reading(self, reading: Reading) -> None:
        """Take one complete, checked reading."""

    def on_bus(self, up: bool, detail: str) -> None:
        """Take note that the bus was lost (`up` False) or came back."""


class Port(Protocol):
    """One connection to one drive.

    Attributes:
        description: The bus in one phrase, such as `udp_multicast 239.74.163.2:43113`.
        counter_modulus: Modulus of the drive's half-cycle counter, None for one without a counter.
        monitor: What the port has seen of the drive, and the verdict on it.
    """

    description: str
    counter_modulus: int | None
    monitor: Monitor

    @property
    def statistics(self) -> PortStatistics:
        """Return the counts since the port was opened."""

    @property
    def trip_cause(self) -> Trip | None:
        """Reason of the protocol not to energise the drive, None for no reason."""

    async def run(self, listener: Listener, opened: Callable[[], None]) -> None:
        """Open the bus, call `opened`, and serve it until cancelled; reconnect when it is lost.

        Raises:
            BusError: The bus cannot be opened at the first attempt.
        """

    def send(self, command: Command) -> bool:
        """Send one command now; False when the bus did not take it (counted, not retried)."""

    def catch_up(self) -> None:
        """Pass the frames that have arrived, but were not read yet, to the listener."""

    def explain_age(self) -> Trip | None:
        """Return the oldest value, its source, and the likeliest cause of its age with its kind.

        Called when the values are too old to be used, never in a tick that drives.
        """

    def details(self) -> list[str]:
        """Return the messages of the bus that were not used, as lines of text."""

    async def reset_fault(self) -> None:
        """Reset a latched fault of the drive; ends in bounded time.

        Called when the operator resets, and at no other time.
        """


class SensorListener(Protocol):
    """Receiver of a sensor bus's events. Called in the event loop; must return at once."""

    def on_values(self, values: Mapping[str, float], taken_s: float) -> None:
        """Take checked values by name, none of which was measured before `taken_s`."""

    def on_bus(self, up: bool, detail: str) -> None:
        """Take note that the bus was lost (`up` False) or came back."""


AnyListener = TypeVar("AnyListener", Listener, SensorListener)


class SensorPort(Protocol):
    """One connection to the sensors on one bus.

    Attributes:
        description: The bus in one phrase.
    """

    description: str

    @property
    def statistics(self) -> PortStatistics:
        """Counts since the port was built."""

    async def run(self, listener: SensorListener) -> None:
        """Serve the bus until cancelled; one that cannot be opened is tried again for ever."""


# The newest good value of each quantity of a drive, and the readings that are made of them.


class NewestValues:
    """The newest good value of each quantity, with its time.

    Attributes:
        faults: Faults that no reading has carried yet.
        refused: Quantities whose newest value must not be used: an older one is held.
    """

    def __init__(self, sources: Collection[Source[Any]], *more: str) -> None:
        """Begin without a value.

        Args:
            sources: Where the drive gives its values.
            more: Quantities that are made of what else it gives.
        """
        self._slacks = dict.fromkeys(more, 0.0) | {one.quantity: one.slack_s for one in sources}
        self._is_patient = any(self._slacks.values())
        self._others = tuple(one.quantity for one in sources if one.is_other)
        self._values: dict[str, float] = {}
        self._taken_s: dict[str, float] = {}
        self.faults = FaultLatch({one.quantity: one.word for one in sources if one.word})
        self.refused: set[str] = set()

    def keep(
        self, values: Mapping[str, float], taken_s: float, refused: Collection[str] = ()
    ) -> None:
        """Keep the good values of one frame or poll.

        Args:
            values: By quantity; the bridge is 1 while it is on.
            taken_s: Their time by the monotonic clock.
            refused: Quantities whose values in it must not be used.
        """
        for name, value in values.items():
            self._values[name], self._taken_s[name] = value, taken_s
        self.faults.see(values)
        if refused or self.refused:
            self.refused = (self.refused - values.keys()).union(refused)

    def forget(self, quantity: str) -> None:
        """Make no reading until a quantity has come again."""
        self._taken_s.pop(quantity, None)

    def reading(
        self, arrival_s: float, *, bridge: bool = False, set_s: float | None = None
    ) -> Reading | None:
        """Return the newest values and each fault since the last reading; None before all came.

        Args:
            arrival_s: Arrival of the newest frame.
            bridge: The bridge of a drive that does not report it.
            set_s: Time of a set of values that came together, None where each has its own.
        """
        values, taken_s, slacks = self._values, self._taken_s, self._slacks
        if len(taken_s) < len(slacks):
            return None
        self.faults.see(values)
        oldest_s, slack_s = min(taken_s.values()), 0.0
        if self._is_patient:
            due_s, slack_s = min([(taken_s[name] + slack, slack) for name, slack in slacks.items()])
            oldest_s = due_s - slack_s
        counted = "counter" in values and "counter" not in self.refused
        bridge_s = taken_s.get("bridge")
        word = self.faults.word
        return Reading(
            arrival_s,
            oldest_s,
            int(values["counter"]) if counted else None,
            values.get("boost_voltage_V", math.nan),
            values.get("line_voltage_V", math.nan),
            values.get("load_power_W", math.nan),
            values.get("output", math.nan),
            word,
            bridge if bridge_s is None else values["bridge"] != 0.0,
            {name: values[name] for name in self._others},
            slack_s,
            self.faults.name if word else "",
            None if bridge_s == oldest_s == set_s else bridge_s,
            not self.refused,
            self.faults.warning,
            taken_s.get("boost_voltage_V"),
        )

    def fresh(self, now_s: float, stale_s: float) -> dict[str, float]:
        """Return the values that are not stale, by quantity.

        Args:
            now_s: The monotonic clock.
            stale_s: Age at which a value is stale that may not be older, in s.
        """
        ages_s = {name: now_s - taken_s for name, taken_s in self._taken_s.items()}
        old = {name for name, age_s in ages_s.items() if age_s > stale_s + self._slacks[name]}
        return {name: value for name, value in self._values.items() if name in ages_s.keys() - old}

    def oldest(self) -> tuple[str, float, float]:
        """Return the quantity that is out of date first, its time, and that of the newest value.

        A time is -inf before the first value.
        """
        times = {name: self._taken_s.get(name, -math.inf) for name in self._slacks}
        oldest = min(times, key=lambda name: times[name] + self._slacks[name])
        return oldest, times[oldest], max(times.values())
