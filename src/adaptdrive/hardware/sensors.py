"""Values of sensor buses with their measurement times, and the values derived from them.

A value keeps the time of its measurement for as long as it is held. Nothing here waits: the buses
bring their values when they have them, and the fast loop takes those that are there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from adaptdrive.config.supply import Rule
from adaptdrive.hardware.port import SensorPort


@dataclass(frozen=True, slots=True)
class Derivation:
    """A value that is made of others.

    Attributes:
        name: Its name.
        rule: What is made of the others.
        of: Names of the others.
        scale: Factor of the result.
        offset: Added to the scaled result.
    """

    name: str
    rule: Callable[[Sequence[float]], float]
    of: tuple[str, ...]
    scale: float = 1.0
    offset: float = 0.0

    def value(self, values: Mapping[str, float]) -> float:
        """The value, NaN while one of the others is not there."""
        parts = [values.get(name, math.nan) for name in self.of]
        return self.rule(parts) * self.scale + self.offset


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
        news: Whether values have come since this was last cleared.
    """

    name: str
    port: SensorPort
    stale_s: float
    needed: tuple[str, ...]
    report: Callable[[bool, str], None] = lambda _up, _detail: None
    values: dict[str, float] = field(default_factory=dict)
    taken_s: dict[str, float] = field(default_factory=dict)
    up: bool = True
    detail: str = ""
    news: bool = False

    def on_values(self, values: Mapping[str, float], taken_s: float) -> None:
        """Keep checked values."""
        self.values.update(values)
        self.taken_s.update(dict.fromkeys(values, taken_s))
        self.news = True

    def on_bus(self, up: bool, detail: str) -> None:
        """Store the state, and report it."""
        self.up, self.detail = up, detail
        self.report(up, f"sensor bus {self.name}: {detail}")

    def complaint(self, now_s: float) -> str | None:
        """The needed value that is too old, or that never came, in words."""
        for name in self.needed:
            taken_s = self.taken_s.get(name)
            if taken_s is None:
                return f"stale: {self.name}.{name}: no measurement yet{self._why()}"
            age_s = now_s - taken_s
            if not age_s <= self.stale_s:
                return (
                    f"stale: {self.name}.{name} is {age_s * 1e3:.0f} ms old, "
                    f"limit {self.stale_s * 1e3:g} ms{self._why()}"
                )
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
"""What each rule of `[derived]` makes of the values that it names."""
