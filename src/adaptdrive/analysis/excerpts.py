"""Uninterrupted parts of a recorded session, for identification, and its load as a plant."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from adaptdrive.analysis.curves import Array, row_times
from adaptdrive.control.loads.load import Load, to_input
from adaptdrive.control.signals import Mode, Order, Stage
from adaptdrive.identification.excerpt import Excerpt, held_step
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.recording.reader import Session
from adaptdrive.recording.session import TableName
from adaptdrive.util.errors import IdentificationError

_COLUMNS = (
    "boost_voltage_V",
    "output",
    "reference",
    "load_power_W",
    "pole",
    "manual_V",
    "steady",
    "tick_period_s",
)
_LONGEST_GAP = 5
"""Missing readings in a row that are filled in on a straight line; a longer gap divides."""

_BLOCKS_PER_PERIOD = 10
_MOST_BLOCKS = 20_000


@dataclass(frozen=True, slots=True)
class Stretch:
    """Uninterrupted part of a session in which the drive ran, at a constant rate.

    Attributes:
        begin_s: Time of its first sample since the first tick of the session.
        period_s: Time between two samples.
        samples_per_period: Samples in a slow period; the first sample begins one.
        columns: Values of `boost_voltage_V`, `output`, `reference`, `load_power_W`, `pole`,
            `manual_V` and `steady`.
        modes: Mode asked for at each sample, as its place in `Mode`.
    """

    begin_s: float
    period_s: float
    samples_per_period: int
    columns: dict[str, Array]
    modes: NDArray[np.int8]

    @property
    def excerpt(self) -> Excerpt:
        """Return the part that identification needs."""
        return Excerpt(self.columns["boost_voltage_V"], self.columns["output"], self.period_s)

    def orders(self, pole: float | None = None) -> Iterator[Order]:
        """Yield the recorded orders.

        Args:
            pole: Replaces the recorded closed-loop pole; None to keep it.
        """
        names, modes = ("reference", "pole", "manual_V", "steady"), tuple(Mode)
        columns = (np.nan_to_num(self.columns[name]).tolist() for name in names)
        for mode, reference, own, manual_V, steady in zip(self.modes, *columns, strict=True):
            asked = own if pole is None else pole
            yield Order(Stage.RUN, reference, modes[mode], asked, manual_V, steady > 0.5)


def read_stretches(
    session: Session, begin_s: float | None = None, end_s: float | None = None
) -> tuple[list[Stretch], int]:
    """Read the parts of a session in which the drive ran.

    Args:
        session: The session.
        begin_s: Seconds after its first tick, None for that tick.
        end_s: Seconds after its first tick, None for its last one.

    Returns:
        The parts, and how many others are left out, as they are shorter than a slow period.

    Raises:
        IdentificationError: The drive did not run in there, or for less than a slow period.
    """
    rows = _running(session, begin_s or 0.0, math.inf if end_s is None else end_s)
    if len(rows["tick"]) < 2:
        raise IdentificationError(f"{session.path}: the drive did not run in that time")
    stride = int(np.median(np.diff(rows["tick"])))
    gaps = np.flatnonzero(np.diff(rows["tick"]) > (_LONGEST_GAP + 1) * stride) + 1
    parts = np.split(np.arange(len(rows["tick"])), gaps)
    period = session.info.ticks_per_period
    # one for all: the line's frequency wanders by less than matters, and one grid needs one period
    period_s = stride * float(np.mean(rows["tick_period_s"]))
    found = [
        _stretch({n: v[part] for n, v in rows.items()}, stride, period, period_s) for part in parts
    ]
    whole = [one for one in found if one is not None]
    if not whole:
        raise IdentificationError(
            f"{session.path}: too short: the drive ran for less than a slow period in that time"
        )
    return whole, len(found) - len(whole)


def block_samples(stretches: list[Stretch]) -> int:
    """Return how many samples to average: whole blocks fill a slow period, or the reverse."""
    per_period = stretches[0].samples_per_period
    total = sum(len(one.columns["output"]) for one in stretches)
    wanted = max(per_period / _BLOCKS_PER_PERIOD, total / _MOST_BLOCKS)
    if wanted > per_period:
        return per_period * math.ceil(wanted / per_period)
    return min(n for n in range(1, per_period + 1) if per_period % n == 0 and n >= wanted)


def _running(session: Session, begin_s: float, end_s: float) -> dict[str, Any]:
    """Return time, tick and columns of the ticks with a fresh reading of a running drive."""
    first_s, parts = math.nan, []
    read = ("monotonic_s", "tick", "stage", "fresh", "mode", *_COLUMNS)
    for batch in session.batches(TableName.TICKS, read):
        time_s = row_times(session, batch)
        first_s = time_s[0] if math.isnan(first_s) and len(time_s) else first_s
        since_s = time_s - first_s
        chosen = _equal(batch, "stage", Stage.RUN.value) & ~_equal(batch, "fresh", wanted=False)
        chosen &= (since_s >= begin_s) & (since_s <= end_s)
        part: dict[str, Any] = {"time_s": since_s[chosen], "mode": _modes(batch)[chosen]}
        for name in ("tick", *_COLUMNS):
            values = batch.column(name).to_numpy(zero_copy_only=False)
            part[name] = np.asarray(values, dtype=np.float64)[chosen]
        parts.append(part)
    if not parts:
        return {"tick": []}
    return {name: np.concatenate([one[name] for one in parts]) for name in parts[0]}


def _modes(batch: pa.RecordBatch) -> NDArray[np.int8]:
    """Return the mode of each row, as its place in `Mode`: a byte, where a day has 10⁷ rows."""
    names = batch.column("mode").cast(pa.string())
    places = pc.index_in(names, value_set=pa.array([mode.value for mode in Mode]))
    return np.asarray(places.to_numpy(zero_copy_only=False), dtype=np.int8)


def _equal(batch: pa.RecordBatch, name: str, wanted: str | bool) -> NDArray[np.bool_]:
    """Return where a column has a value; null is none."""
    found = pc.fill_null(pc.equal(batch.column(name), wanted), fill_value=False)
    return np.asarray(found.to_numpy(zero_copy_only=False), dtype=np.bool_)


def _stretch(
    rows: dict[str, Any], stride: int, ticks_per_period: int, period_s: float
) -> Stretch | None:
    """Put rows on a regular grid that begins with a slow period."""
    ticks = rows["tick"]
    begin = math.ceil((ticks[0] - stride) / ticks_per_period) * ticks_per_period + stride
    grid = np.arange(begin, ticks[-1] + 1, stride)
    if len(grid) < 2:
        return None
    columns = {name: np.interp(grid, ticks, rows[name]) for name in _COLUMNS[:-1]}
    return Stretch(
        begin_s=float(np.interp(begin, ticks, rows["time_s"])),
        period_s=period_s,
        samples_per_period=max(1, ticks_per_period // stride),
        columns=columns,
        modes=rows["mode"][np.minimum(np.searchsorted(ticks, grid), len(ticks) - 1)],
    )


# The load of a recorded session as a plant, with the disturbances of the record.


class IdentifiedPlant:
    """An identified load behind the boost capacitor; it begins at rest.

    Attributes:
        disturbance: What is added to the output of each step; nothing after its end.
    """

    def __init__(
        self,
        load: IdentifiedLoad,
        structure: Load,
        period_s: float,
        rest: tuple[float, float],
        power: Array,
    ) -> None:
        """Put a load at rest.

        Args:
            load: The load.
            structure: Its input map.
            period_s: Length of each step.
            rest: Boost voltage and output at rest.
            power: Factors of v², v and v·y in the power that it draws.
        """
        self.disturbance: Iterator[float] = iter(())
        self._structure, self._power = structure, power
        self._denominator, self._numerator = np.array(load.denominator), np.array(load.numerator)
        self._offset = load.input_offset.value
        self._transition, self._entry = held_step(self._denominator, period_s)
        rest_V, self._output = rest
        self._late = deque([self._input(rest_V)] * round(load.delay_s / period_s))
        self._state = np.zeros(len(self._denominator) - 1)
        self._state[0] = self._output / self._numerator[-1]

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        """Advance by one step, whatever its duration."""
        del duration_s
        self._late.append(self._input(boost_voltage_V))
        load_input = self._late.popleft()
        volts, output = boost_voltage_V, self._output
        power_W = max(0.0, float(np.array([volts**2, volts, volts * output]) @ self._power))
        self._state = self._transition @ self._state + self._entry * load_input
        direct, slope = self._numerator[0], self._numerator[:0:-1]
        fed = load_input - self._denominator[:0:-1] @ self._state
        self._output = float(slope @ self._state + direct * fed)
        return self._output + next(self.disturbance, 0.0), power_W

    def _input(self, boost_voltage_V: float) -> float:
        own = self._structure
        return to_input(boost_voltage_V, own.input_gain, own.input_exponent) + self._offset


def _power_law(stretch: Stretch) -> Array:
    """Return the factors of v², v and v·y that fit the recorded power best.

    Behind the dc/dc stage a load draws the current (N2 v - E)/R with E a constant, as that of a
    battery, or proportional to the output, as that of a motor.
    """
    columns = stretch.columns
    volts, outputs = columns["boost_voltage_V"], columns["output"]
    rows = np.column_stack((volts**2, volts, volts * outputs))
    lengths = np.linalg.norm(rows, axis=0)
    lengths[lengths == 0.0] = 1.0
    found: Array = np.linalg.lstsq(rows / lengths, columns["load_power_W"])[0] / lengths
    return found


def disturbed_plant(load: IdentifiedLoad, structure: Load, stretch: Stretch) -> IdentifiedPlant:
    """Return the plant with what the record has besides its response to the recorded voltage.

    Noise, torques, and the error of the model: fed with the recorded voltage it gives the record.
    """
    volts, output = stretch.columns["boost_voltage_V"], stretch.columns["output"]
    rest, power = (float(volts[0]), float(output[0])), _power_law(stretch)
    plant, made = (
        IdentifiedPlant(load, structure, stretch.period_s, rest, power) for _ in range(2)
    )
    means = np.concatenate((volts[:1], 0.5 * (volts[:-1] + volts[1:])))
    simulated = [plant.step(volt, stretch.period_s)[0] for volt in means.tolist()]
    made.disturbance = iter((output - np.array(simulated)).tolist())
    return made
