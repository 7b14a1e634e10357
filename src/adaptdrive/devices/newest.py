"""The newest good value of each quantity of a drive, and the readings that are made of them.

Each quantity is judged by itself. A value that must not be used does not replace the last good one
of its quantity: that one keeps its own time and ages.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping

from adaptdrive.devices.faults import FaultLatch, FaultWord
from adaptdrive.devices.port import Reading


class NewestValues:
    """The newest good value of each quantity, with its time.

    Attributes:
        faults: Faults that no reading has carried yet.
        refused: Quantities whose newest value must not be used: an older one is held.
    """

    def __init__(
        self, slacks: Mapping[str, float], others: Iterable[str], faults: Mapping[str, FaultWord]
    ) -> None:
        """Know no value yet.

        Args:
            slacks: How much older than `interlocks.stale_s` a value may be, by quantity, in s.
            others: Names of those that are no field of a reading.
            faults: Fault words of the drive.
        """
        self._slacks = dict(slacks)
        self._is_patient = any(self._slacks.values())
        self._others = tuple(others)
        self._values: dict[str, float] = {}
        self._taken_s: dict[str, float] = {}
        self.faults = FaultLatch(faults)
        self.refused: set[str] = set()

    @property
    def powered(self) -> bool:
        """True if the newest report has the bridge on, also one that was forgotten."""
        return self._values.get("bridge", 0.0) != 0.0

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

    def doubt(self, values: Mapping[str, float]) -> None:
        """Keep faults, and a bridge that is on, of a frame that may be old: no value is newer."""
        self.faults.see(values)
        if values.get("bridge"):
            self._values["bridge"] = 1.0

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
