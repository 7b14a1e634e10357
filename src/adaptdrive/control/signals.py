"""The values that enter and leave the controller, and set-points that move by themselves.

All inputs of the controller arrive in a `Measurement` and an `Order`; all its outputs
leave in a `Command`. A recording of the first two reproduces the third bit for bit. A field that
is annotated with a `Quantity` is a column of the messages and of the recording.
"""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Self

from adaptdrive.util.quantity import Quantity

# Set-points that move by themselves: pure functions of the time since they were started.


class Shape(StrEnum):
    """Shapes a set-point can follow."""

    SQUARE = "square"
    SINE = "sine"
    TRIANGLE = "triangle"


@dataclass(frozen=True, slots=True)
class Waveform:
    """A periodic set-point; the high half comes first.

    Attributes:
        shape: Form of one period.
        low: Lowest value, unit of the output.
        high: Highest value, unit of the output.
        period_s: Length of one period.
    """

    shape: Shape
    low: float
    high: float
    period_s: float

    def value(self, elapsed_s: float) -> float:
        """The set-point `elapsed_s` after the waveform was started."""
        phase = math.fmod(elapsed_s, self.period_s) / self.period_s
        return self.low + (self.high - self.low) * _LEVELS[self.shape](phase)


@dataclass(frozen=True, slots=True)
class Ramp:
    """A set-point on its way to another one.

    Attributes:
        start: Where it begins, unit of the output.
        end: Where it stays.
        slope: Its change in one second, above 0.
    """

    start: float
    end: float
    slope: float

    def value(self, elapsed_s: float) -> float:
        """The set-point `elapsed_s` after the ramp was started."""
        way, distance = self.slope * max(0.0, elapsed_s), self.end - self.start
        if not abs(distance) > way:
            return self.end
        return self.start + math.copysign(way, distance)


_RAMP = "ramp"


@dataclass(frozen=True, slots=True)
class MovingReference:
    """A set-point that moves by itself from a tick on.

    Attributes:
        form: How it moves.
        begin_tick: Tick of its start.
    """

    form: Waveform | Ramp
    begin_tick: int

    def value(self, tick: int, tick_s: float) -> float:
        """Return the set-point at a tick.

        Args:
            tick: The tick.
            tick_s: Nominal time from tick to tick.
        """
        return self.form.value((tick - self.begin_tick) * tick_s)

    def __str__(self) -> str:
        form = self.form
        if isinstance(form, Ramp):
            return f"{_RAMP} {form.start!r} {form.end!r} {form.slope!r} {self.begin_tick}"
        return f"{form.shape} {form.low!r} {form.high!r} {form.period_s!r} {self.begin_tick}"

    @classmethod
    def parse(cls, text: str) -> Self | None:
        """Return the set-point that a text describes, None for an empty one."""
        if not text:
            return None
        kind, *numbers, tick = text.split()
        first, second, third = map(float, numbers)
        if kind == _RAMP:
            return cls(Ramp(first, second, third), int(tick))
        return cls(Waveform(Shape(kind), first, second, third), int(tick))


def _square(phase: float) -> float:
    return 1.0 if phase < 0.5 else 0.0


def _sine(phase: float) -> float:
    return 0.5 + 0.5 * math.sin(2.0 * math.pi * phase)


def _triangle(phase: float) -> float:
    return 1.0 - abs(1.0 - math.fmod(2.0 * phase + 0.5, 2.0))


_LEVELS = {Shape.SQUARE: _square, Shape.SINE: _sine, Shape.TRIANGLE: _triangle}


# The values that enter and leave the controller.


class Mode(StrEnum):
    """Source of V_c that the operator selected: a load controller, or the operator's own value."""

    FIXED = "fixed"
    ADAPTIVE = "adaptive"
    MANUAL = "manual"


class Stage(StrEnum):
    """Degree to which the drive may be energised at a tick."""

    OFF = "off"
    PRECHARGE = "precharge"
    RUN = "run"


@dataclass(frozen=True, slots=True)
class Measurement:
    """The values of drive and sensors at one fast tick."""

    tick: Annotated[int, Quantity("", "half-cycle counter of the drive, unwrapped")]
    tick_period_s: Annotated[float, Quantity("s", "measured length of one half line cycle")]
    boost_voltage_V: Annotated[float, Quantity("v", "voltage of the boost capacitor, v_bst")]
    line_voltage_V: Annotated[float, Quantity("V", "line voltage, rms")]
    load_power_W: Annotated[float, Quantity("W", "power drawn from the boost capacitor")]
    output: Annotated[float, Quantity("y", "the regulated quantity")]
    fresh: Annotated[
        bool, Quantity("", "false where a stand-in tick holds the values of an earlier one")
    ] = True


@dataclass(frozen=True, slots=True)
class Order:
    """Request to the controller at one fast tick."""

    stage: Annotated[Stage, Quantity("", "how far the drive may be energised")]
    reference: Annotated[float, Quantity("y", "set-point")]
    mode: Annotated[Mode, Quantity("", "source of V_c asked for: fixed, adaptive or manual")]
    pole: Annotated[
        float, Quantity("", "closed-loop pole asked for, in the z-plane of the slow rate")
    ]
    manual_V: Annotated[float, Quantity("v", "V_c asked for in mode manual, 0 in every other")] = (
        0.0
    )
    steady: Annotated[
        bool, Quantity("", "true while the set-point is constant, so that it may be probed")
    ] = False
    moving: Annotated[
        MovingReference | None,
        Quantity(
            "",
            "set-point of which the controller knows what comes: shape, low, high and period in s, "
            "or ramp, start, end and slope per s; then the tick of its start; empty for none",
            "moving_reference",
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class Command:
    """Command to the drive, in force from one fast tick on."""

    current_scale_S: Annotated[
        float, Quantity("S", "line-current scale k: line current over line voltage")
    ]
    boost_reference_V: Annotated[
        float,
        Quantity(
            "v", "V_c, for drives that hold their own boost voltage", "command_boost_reference_V"
        ),
    ]
    bridge: Annotated[bool, Quantity("", "true when the dc/dc bridge may feed the load")]


SAFE_COMMAND = Command(current_scale_S=0.0, boost_reference_V=0.0, bridge=False)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Data that the fast half passes to the slow half at tick n = kQ."""

    k: Annotated[int, Quantity("", "slow index")]
    tick: Annotated[int, Quantity("", "fast tick of the snapshot")]
    period_s: Annotated[float, Quantity("s", "slow period T_k: Q times the measured tick period")]
    order: Order
    output: Annotated[
        float, Quantity("y", "regulated quantity: screened, mean over the averaging window")
    ]
    output_filtered: Annotated[
        tuple[float, ...], Quantity("y", "[λy, λ²y, …], means over the same window")
    ]
    input_filtered: Annotated[
        tuple[float, ...], Quantity("u", "[u, λu, λ²u, …], means over the same window")
    ]
    applied_V: Annotated[float, Quantity("v", "mean boost voltage over the elapsed slow period")]
    followed: Annotated[
        bool, Quantity("", "false where a limit kept the boost voltage from following V_c")
    ]
    held_ticks: Annotated[
        int, Quantity("", "ticks of the elapsed slow period without a fresh measurement")
    ]
    held_V: Annotated[
        float,
        Quantity("v", "V_c in force where the operator set it in the elapsed period, else unknown"),
    ] = math.nan
    resolution: Annotated[
        float, Quantity("y", "step of the sensor: as configured, else as found; 0 for none")
    ] = 0.0
    rounding: Annotated[
        float, Quantity("y", "standard deviation of the rounding error of a slow sample")
    ] = 0.0
    upcoming: tuple[float, ...] = ()


@dataclass(slots=True)
class SlowSample:
    """Input of the slow half in each period.

    Attributes:
        period_s: T_k.
        output: y[k].
        output_filtered: λy ... λ^m y.
        input_filtered: u, λu ... λ^m u.
        applied: Input applied over the elapsed period, NaN while unknown.
        followed: False where a limit kept the drive from following.
        held_share: Share of the elapsed ticks without a fresh measurement.
        reference: r[k].
        adaptive: True when the operator asks for the adaptive controller.
        pole: Pole asked for.
        low: Lowest input.
        high: Highest input.
        manual: True when the operator sets the input.
        held: Input in force that the operator has set in the elapsed period, NaN for none.
        steady: Whether r is a constant set-point.
        lowest: Lowest output that V_c can hold, NaN while unknown.
        highest: Highest output that V_c can hold, NaN while unknown.
        rounding: Standard deviation of the rounding error of the output.
        upcoming: r[k+1] and the following ones that preview knows, empty for none.
    """

    period_s: float
    output: float
    output_filtered: list[float]
    input_filtered: list[float]
    applied: float
    followed: bool
    held_share: float
    reference: float
    adaptive: bool
    pole: float
    low: float
    high: float
    manual: bool = False
    held: float = math.nan
    steady: bool = False
    lowest: float = -math.inf
    highest: float = math.inf
    rounding: float = 0.0
    upcoming: list[float] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimated parameter and its standard deviation (NaN while unknown)."""

    value: float
    std: float


@dataclass(frozen=True, slots=True)
class Decision:
    """Result of the slow half for snapshot k.

    `trusted` holds the physical parameters from which a later run may start, None for none.
    """

    k: int
    boost_reference_V: Annotated[float, Quantity("v", "V_c decided now, after limits")]
    controller: Annotated[
        Mode, Quantity("", "source of V_c in force; fixed until the estimates are trusted")
    ]
    accepted: Annotated[
        bool, Quantity("", "true when the estimates of this step reached the adaptive gains")
    ]
    reason: Annotated[
        str, Quantity("", "why `controller` is in force, or why the estimates were kept out")
    ]
    estimates: Annotated[
        dict[str, Estimate],
        Quantity("", "load parameters by name, in SI: value and standard deviation"),
    ]
    gains: Annotated[
        tuple[float, ...], Quantity("", "r_1 … r_n, s_0 … s_m and t_0 of the law in force")
    ]
    innovation: Annotated[float, Quantity("y", "one-step prediction error of the estimator")]
    excitation: Annotated[float, Quantity("", "rᵀPr: how much this sample could teach")]
    handover_step_V: Annotated[
        float,
        Quantity(
            "u",
            "law not in force minus law in force, on the same history; "
            "unknown before the first trusted estimate",
        ),
    ]
    pole: Annotated[
        float, Quantity("", "closed-loop pole with which set-points are answered", "pole_in_force")
    ] = math.nan
    fault: Annotated[str, Quantity("", "why the drive must be tripped, empty for no reason")] = ""
    fault_kind: Annotated[str, Quantity("", "kind of that trip, empty for none")] = ""
    complete: Annotated[
        bool, Quantity("", "true when nothing is left to do, such as with a full battery")
    ] = False
    reach_low: Annotated[
        float, Quantity("y", "output at rest at the lowest V_c: the lowest that can be held")
    ] = math.nan
    reach_high: Annotated[
        float, Quantity("y", "output at rest at the highest V_c: the highest that can be held")
    ] = math.nan
    probe: Annotated[
        float,
        Quantity("y", "shift of the set-point while the load is probed, unknown while it is not"),
    ] = math.nan
    response_spread: Annotated[
        float,
        Quantity(
            "",
            "how far the response to a step may be off by what the accepted estimates leave open, "
            "as a share of the step",
        ),
    ] = math.nan
    change: Annotated[
        str,
        Quantity(
            "",
            "change that the bank of models has decided on: disturbance, load, or load and "
            "disturbance; empty for none",
        ),
    ] = ""
    trusted: tuple[float, ...] | None = None


# What V_c can hold.


@dataclass(frozen=True, slots=True)
class Reach:
    """Reachable range of the output; NaN for an end that is not known.

    Attributes:
        low: Output at rest at the lowest V_c.
        high: Output at rest at the highest V_c.
    """

    low: float = math.nan
    high: float = math.nan

    @property
    def is_known(self) -> bool:
        """True where both ends are known."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def nearest(self, value: float) -> float:
        """Return the output within reach that is nearest; the same while the range is not known."""
        if value > self.high:
            return self.high
        return max(value, self.low)


UNKNOWN = Reach()
"""Reach of a load of which not enough is known."""
