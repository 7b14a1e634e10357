"""Sensor buses, the values derived from them, and the port of a drive that has them.

A value keeps the time of its measurement for as long as it is held. The drive's own port clocks and
commands. Each of its readings is completed with the last values of the sensor buses and with what
is derived from all of it. Nothing is waited for: a sensor that is silent leaves its last value,
which grows old until the port refuses to energise.
"""

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from adaptdrive.config.root import Derived, Rule, needed_names
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices import port as ports
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.quantity import MEASURED


@dataclass(slots=True)
class SensorBus:
    """One sensor bus with its latest values. Listens to its port.

    Attributes:
        name: Name of the bus.
        port: Where its values come from.
        stale_s: Oldest usable value.
        needed: Names of those values without which the drive must not be energised.
        report: Called when the bus is lost or open again.
        values: Latest values by name.
        taken_s: When each was measured, at the earliest; monotonic.
        up: Whether the bus answers.
        detail: Its latest report.
        is_new: Whether values have come since this was last cleared.
    """

    name: str
    port: ports.SensorPort
    stale_s: float
    needed: tuple[str, ...]
    report: Callable[[bool, str], None] = lambda _up, _detail: None
    values: dict[str, float] = field(default_factory=dict)
    taken_s: dict[str, float] = field(default_factory=dict)
    up: bool = True
    detail: str = ""
    is_new: bool = False

    def on_values(self, values: Mapping[str, float], taken_s: float) -> None:
        """Keep checked values."""
        self.values.update(values)
        self.taken_s.update(dict.fromkeys(values, taken_s))
        self.is_new = True

    def on_bus(self, up: bool, detail: str) -> None:
        """Store the state, and report it."""
        self.up, self.detail = up, detail
        self.report(up, f"sensor bus {self.name}: {detail}")

    def trip_cause(self, now_s: float) -> Trip | None:
        """The needed value that is too old, or that never came, in words."""
        for name in self.needed:
            taken_s = self.taken_s.get(name)
            if taken_s is None:
                text = f"stale: {self.name}.{name}: no measurement yet{self._why()}"
                return Trip(TripKind.SENSOR_MISSING, text)
            age_s = now_s - taken_s
            if not age_s <= self.stale_s:
                old = f"stale: {self.name}.{name} is {age_s * 1e3:.0f} ms old"
                limit = f"limit {self.stale_s * 1e3:g} ms"
                return Trip(TripKind.SENSOR_STALE, f"{old}, {limit}{self._why()}")
        return None

    def _why(self) -> str:
        if self.up:
            return "; its bus answers: check the sensor, its wire and its module"
        return f" ({self.detail})"


def _unless_nan(pick: Callable[[Sequence[float]], float]) -> Callable[[Sequence[float]], float]:
    """Return what picks one of several values, NaN when any is."""
    return lambda values: math.nan if any(map(math.isnan, values)) else pick(values)


RULES: Mapping[Rule, Callable[[Sequence[float]], float]] = {
    "sum": sum,
    "mean": lambda values: sum(values) / len(values),
    "difference": lambda values: values[0] - values[1],
    "product": math.prod,
    "ratio": lambda values: values[0] / values[1] if values[1] else math.nan,
    "smallest": _unless_nan(min),
    "largest": _unless_nan(max),
}
"""Functions of the rules of `[derived]`, each from the values that it names to the derived one."""


def derived_value(one: Derived, values: Mapping[str, float]) -> float:
    """Return a value that is made of others, NaN while one of them is not there.

    Args:
        one: How it is made of them.
        values: By name.
    """
    parts = [values.get(name, math.nan) for name in one.of]
    return RULES[one.rule](parts) * one.scale + one.offset


class SensoredPort:
    """A drive and its separate sensors, as one port.

    Attributes:
        description: The drive's bus and those of the sensors in one phrase.
        counter_modulus: As of the drive's own port, like all that follow.
        monitor: What the drive's port has seen of it.
        catch_up: Hands over what has arrived from the drive; sensors are never caught up with.
        explain_age: Returns the oldest value of the drive; sensors give theirs in `trip_cause`.
        details: Returns the messages of the drive's bus that were not used.
        reset_fault: Resets a latched fault of the drive.
    """

    def __init__(
        self,
        drive: ports.Port,
        buses: Sequence[SensorBus],
        derived: Mapping[str, Derived],
        clock: Callable[[], float],
        stated: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Join a drive and its sensors.

        Args:
            drive: The drive's own port.
            buses: Its sensor buses.
            derived: Values made of others, each after those that it is made of.
            clock: Monotonic clock in seconds.
            stated: Values that nobody measures.
        """
        self._stated = stated
        self._drive = drive
        self.counter_modulus = drive.counter_modulus
        self.monitor = drive.monitor
        self.catch_up = drive.catch_up
        self.explain_age = drive.explain_age
        self.details = drive.details
        self.reset_fault = drive.reset_fault
        self.buses = tuple(buses)
        sensors = [f"sensors {bus.name} on {bus.port.description}" for bus in buses]
        self.description = "; ".join([drive.description, *sensors])
        self._derived = derived
        self._voltage_parts = needed_names(derived, ("boost_voltage_V",))
        self._clock = clock
        self._listener: ports.Listener | None = None
        self._ends = False
        self.sampled: Callable[[], None] = lambda: None
        """Called after a reading of the drive that had new values of a sensor bus."""

    @property
    def statistics(self) -> ports.PortStatistics:
        """Counts of the drive's own port."""
        return self._drive.statistics

    @property
    def trip_cause(self) -> Trip | None:
        """Complaint of the drive's protocol, else the sensor value that is too old."""
        trip_cause, now_s = self._drive.trip_cause, self._clock()
        for bus in self.buses:
            trip_cause = trip_cause or bus.trip_cause(now_s)
        return trip_cause

    async def run(self, listener: ports.Listener, opened: Callable[[], None]) -> None:
        """Serve the drive and the sensors until cancelled; the sensors end first.

        Args:
            listener: Receiver of readings and of the states of the buses.
            opened: Called once, when the drive's bus is open.

        Raises:
            ExceptionGroup: A task died; a `BusError` in it when the drive's bus cannot be opened.
        """
        self._listener = listener
        for bus in self.buses:
            bus.report = listener.on_bus
        async with asyncio.TaskGroup() as tasks:
            for bus in self.buses:
                tasks.create_task(self._sense(bus), name=f"sensor bus {bus.name}")
            tasks.create_task(self._drive.run(self, opened), name="drive")

    async def _sense(self, bus: SensorBus) -> None:
        """Serve a sensor bus; an error in that leaves the drive safe before its bus is closed."""
        try:
            await bus.port.run(bus)
        except Exception:
            self._ends = True  # no other command goes out from now on
            for _ in range(ports.LAST_STOPS):
                self._drive.send(SAFE_COMMAND)
                await asyncio.sleep(ports.LAST_STOP_GAP_S)
            raise

    def send(self, command: Command) -> bool:
        """Send one command to the drive now, the safe one once a sensor bus has failed."""
        return self._drive.send(SAFE_COMMAND if self._ends else command)

    def on_reading(self, reading: Reading) -> None:
        """Complete a reading of the drive and pass it on."""
        if self._listener is not None:
            self._listener.on_reading(self.completed(reading))
            renewed = [bus for bus in self.buses if bus.is_new]
            for bus in renewed:
                bus.is_new = False
            if renewed:
                self.sampled()

    def on_bus(self, up: bool, detail: str) -> None:
        """Pass on that the drive's bus was lost or came back."""
        if self._listener is not None:
            self._listener.on_bus(up, detail)

    def completed(self, reading: Reading) -> Reading:
        """Return a reading with the values of the sensors and those that are derived.

        Args:
            reading: Reading of the drive.
        """
        values = {name: getattr(reading, name) for name in MEASURED}
        values.update(reading.other)
        values.update(self._stated)
        for bus in self.buses:
            values.update(bus.values)
        for name, one in self._derived.items():
            values[name] = derived_value(one, values)
        found = {name: values.get(name, math.nan) for name in MEASURED}
        return replace(reading, other=values, voltage_s=self._voltage_s(reading), **found)

    def _voltage_s(self, reading: Reading) -> float | None:
        """Return when the oldest sensor value of which v_bst is made was taken."""
        times = [
            bus.taken_s[name]
            for bus in self.buses
            for name in self._voltage_parts.intersection(bus.taken_s)
        ]
        return min(times, default=reading.voltage_s)
