"""The values that enter and leave the controller, their columns, and set-point waveforms.

A field is declared once, in its dataclass, with its unit and its meaning. The MQTT message, the
recorded row, the Arrow schema and the page `docs/columns.md` are made from that declaration.

All inputs of the controller arrive in a `Measurement` and an `Order`; all its outputs
leave in a `Command`. A recording of the first two reproduces the third bit for bit. A field that
is annotated with a `Quantity` is a column of the messages and of the recording.
"""

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass, is_dataclass
from enum import StrEnum
from functools import cache
from operator import attrgetter
from types import UnionType
from typing import Annotated, Any, Self, TypeVar, get_args, get_origin, get_type_hints

# Columns: the fields of a fast tick and of a slow step, as published, recorded and documented.

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Quantity:
    """The annotation of a field that is a column.

    Attributes:
        unit: Unit: a symbol, `y` for the unit of the output, `u` for that of the load's input,
            `v` for that of what the drive is commanded, and gives, or an empty string for a plain
            number or a text.
        meaning: What the value is.
        name: Name of the column where the field's own is not unique.
    """

    unit: str
    meaning: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class Column:
    """One column.

    Attributes:
        name: Its name in messages and on disk.
        kind: `float`, `int`, `bool`, `str`, `tuple` (of floats) or `dict` (estimates by name).
        unit: Unit, as in `Quantity`.
        meaning: What the value is.
        source: Path of the field in the report.
        read: Takes the value from a report.
        choices: All values that it can have, none where it can have any.
    """

    name: str
    kind: type
    unit: str
    meaning: str
    source: str
    read: Callable[[Any], Any]
    choices: tuple[str, ...] = ()


def columns_of(report: type, path: str = "") -> tuple[Column, ...]:
    """Return the columns of a report: its own fields, and those of the dataclasses in it."""
    columns: list[Column] = []
    for name, (kind, quantity) in _fields(report).items():
        place = f"{path}{name}"
        if quantity is not None:
            choices = tuple(kind) if issubclass(kind, StrEnum) else ()
            is_text = bool(choices) or is_dataclass(kind)
            label, stored = quantity.name or name, str if is_text else kind
            about = (quantity.unit, quantity.meaning, place)
            read = _text_getter(place) if is_dataclass(kind) else attrgetter(place)
            columns.append(Column(label, stored, *about, read, choices))
        elif is_dataclass(kind):
            columns += columns_of(kind, f"{place}.")
    return tuple(columns)


def _text_getter(place: str) -> Callable[[Any], str]:
    """Return what reads a field as text, empty for None."""
    read = attrgetter(place)

    def text(report: Any) -> str:  # noqa: ANN401 - any report
        value = read(report)
        return "" if value is None else str(value)

    return text


def rebuild(report: Callable[..., T], row: dict[str, Any]) -> T:
    """Return the report of which a row holds the columns."""
    values: dict[str, Any] = {}
    for name, (kind, quantity) in _fields(report).items():
        if quantity is not None:
            stored = row[quantity.name or name]
            values[name] = getattr(kind, "parse", kind)(stored)
        elif is_dataclass(kind):
            values[name] = rebuild(kind, row)
    return report(**values)


@cache
def _fields(report: Hashable) -> dict[str, tuple[type, Quantity | None]]:
    """Return type and annotation of each field by its name."""
    plain, annotated = get_type_hints(report), get_type_hints(report, include_extras=True)
    return {name: (_kind(hint), _quantity(annotated[name])) for name, hint in plain.items()}


def _kind(hint: Any) -> type:  # noqa: ANN401 - any annotation
    """Return the class of an annotation, without its parameters and without None."""
    origin = get_origin(hint)
    found: type = get_args(hint)[0] if origin is UnionType else origin or hint
    return found


def _quantity(hint: Any) -> Quantity | None:  # noqa: ANN401 - any annotation
    found = getattr(hint, "__metadata__", ())
    return next((one for one in found if isinstance(one, Quantity)), None)


# Set-point waveforms: pure functions of the time since they were started.


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
class KnownWaveform:
    """A waveform of which the controller may preview what comes.

    Attributes:
        waveform: The set-point.
        begin_tick: Tick of its start.
    """

    waveform: Waveform
    begin_tick: int

    def __str__(self) -> str:
        wave = self.waveform
        return f"{wave.shape} {wave.low!r} {wave.high!r} {wave.period_s!r} {self.begin_tick}"

    @classmethod
    def parse(cls, text: str) -> Self | None:
        """Return the waveform that a text describes, None for an empty one."""
        if not text:
            return None
        shape, low, high, period_s, tick = text.split()
        wave = Waveform(Shape(shape), float(low), float(high), float(period_s))
        return cls(wave, int(tick))


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
    waveform: Annotated[
        KnownWaveform | None,
        Quantity(
            "",
            "waveform of which the controller knows what comes: shape, low, high, period in s and "
            "tick of its start; empty for none",
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


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimated parameter and its standard deviation (NaN while unknown)."""

    value: float
    std: float


@dataclass(frozen=True, slots=True)
class Decision:
    """Result of the slow half for snapshot k."""

    k: int
    boost_reference_V: Annotated[float, Quantity("v", "V_c decided now, after limits")]
    controller: Annotated[
        Mode,
        Quantity("", "source of V_c in force; fixed until the estimates are trusted"),
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
        float,
        Quantity(
            "",
            "closed-loop pole with which set-points are answered",
            "pole_in_force",
        ),
    ] = math.nan
    fault: Annotated[str, Quantity("", "why the drive must be tripped, empty for no reason")] = ""
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
