"""One run of a campaign of baths: everything it depends on is drawn from its seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive_sim.campaign.bath_reach import bath_reach
from adaptdrive_sim.campaign.bath_settings import BathCampaign, BathReferenceRanges, WaterRanges
from adaptdrive_sim.campaign.life import moving
from adaptdrive_sim.compiled.wire import DELAY_MAX, Wire
from adaptdrive_sim.line import LineParameters

Array = NDArray[np.float64]
Numbers = tuple[float, ...]

_STREAM = 4


@dataclass(frozen=True, slots=True)
class BathScenario:
    """Drawn values of a run.

    Attributes:
        seed: It was drawn from this.
        duration_s: Length.
        volumes_gal: Volume, first the initial one.
        fill_times_s: When it begins to change.
        fill_s: How long each change takes.
        inflows: Flow, relative to the model's, first the initial one.
        inflow_times_s: When it changes.
        drift_K_per_h: Drift of the inflow's temperature at the start.
        turn_s: After which it turns.
        resistance: Of the heater at the start, relative to the model's.
        ageing_per_h: Rise of that by ageing, as a share of the resistance at the start.
        reference: The set-point.
        constant: Whether the set-point stays at its low end.
        sigma_K: Noise of every sample.
        spike_share: Share of spikes.
        spike_K: Noise of the spikes.
        output_K: Resolution of the sensor.
        offset_K: Of the sensor.
        output_delay_ticks: Age of its samples.
        line_voltage: Relative line voltage.
        frequency_Hz: Of the line.
        voltage_V: Resolution of voltages.
        power_W: Resolution of the load power.
        scale_S: Resolution of the current scale.
    """

    seed: int
    duration_s: float
    volumes_gal: Numbers
    fill_times_s: Numbers
    fill_s: float
    inflows: Numbers
    inflow_times_s: Numbers
    drift_K_per_h: float
    turn_s: float
    resistance: float
    ageing_per_h: float
    reference: Waveform
    constant: bool
    sigma_K: float
    spike_share: float
    spike_K: float
    output_K: float
    offset_K: float
    output_delay_ticks: int
    line_voltage: float
    frequency_Hz: float
    voltage_V: float
    power_W: float
    scale_S: float

    @property
    def step(self) -> float:
        """Height of the reference's step."""
        return self.reference.high - self.reference.low

    def targets_gal_at(self, times_s: Array) -> Array:
        """Return the volume that is asked for at each time."""
        return moving(times_s, self.fill_times_s, self.volumes_gal, (0.0,) * len(self.fill_times_s))

    def inflows_at(self, times_s: Array) -> Array:
        """Return the flow at each time, relative to the model's."""
        jumps = (0.0,) * len(self.inflow_times_s)
        return moving(times_s, self.inflow_times_s, self.inflows, jumps)

    def references_at(self, times_s: Array) -> Array:
        """Return the set-point at each time."""
        if self.constant:
            return np.full(times_s.size, self.reference.low)
        return np.array([self.reference.value(time_s) for time_s in times_s.tolist()])

    def disturbances(self, count: int) -> Array:
        """Measurement noise of every tick, and the offset."""
        generator = np.random.default_rng([self.seed, 1])
        noise = self.offset_K + self.sigma_K * generator.standard_normal(count)
        if self.spike_share > 0.0:
            struck = np.flatnonzero(generator.random(count) < self.spike_share)
            noise[struck] += self.spike_K * generator.standard_normal(struck.size)
        return noise

    def columns(self) -> dict[str, Any]:
        """Return the drawn values as columns of the results."""
        return {
            "seed": self.seed,
            "volume_first_gal": self.volumes_gal[0],
            "volume_last_gal": self.volumes_gal[-1],
            "volume_largest_gal": max(self.volumes_gal),
            "changes": len(self.fill_times_s),
            "fill_s": self.fill_s,
            "inflow": self.inflows[0],
            "inflow_changes": len(self.inflow_times_s),
            "drift_K_per_h": self.drift_K_per_h,
            "turn_s": self.turn_s,
            "resistance": self.resistance,
            "ageing_per_h": self.ageing_per_h,
            "shape": "constant" if self.constant else self.reference.shape.value,
            "low": self.reference.low,
            "step": self.step,
            "period_s": self.reference.period_s,
            "sigma_K": self.sigma_K,
            "spike_share": self.spike_share,
            "output_K": self.output_K,
            "offset_K": self.offset_K,
            "output_delay_ticks": self.output_delay_ticks,
            "line_voltage": self.line_voltage,
            "frequency_Hz": self.frequency_Hz,
        }

    def line(self) -> LineParameters:
        """The true line."""
        return LineParameters.steady(self.line_voltage, self.frequency_Hz)

    def wire(self) -> Wire:
        """Return the connection between drive and controller, at rest."""
        return Wire(
            output_quantum=self.output_K,
            voltage_quantum_V=self.voltage_V,
            power_quantum_W=self.power_W,
            scale_quantum_S=self.scale_S,
            output_delay=self.output_delay_ticks,
            outputs=[self.reference.low] * (DELAY_MAX + 1),
        )


def draw_bath(campaign: BathCampaign, seed: int) -> BathScenario:
    """The run of a campaign that a seed stands for."""
    generator = np.random.default_rng([seed, _STREAM])
    water, sensor, wire = campaign.water, campaign.sensor, campaign.wire
    volumes_gal, fill_times_s = _volumes(generator, water, campaign.duration_s)
    moves = _whole(generator, water.inflow_changes)
    inflows = tuple(_uniform(generator, water.inflow) for _ in range(moves + 1))
    drift = _uniform(generator, water.drift_K_per_h) * float(generator.choice((-1.0, 1.0)))
    turn_s, offset_K = _uniform(generator, water.turn_s), _uniform(generator, sensor.offset_K)
    resistance = _uniform(generator, campaign.heater.resistance)
    ageing = _uniform(generator, campaign.heater.ageing_per_h)
    aged = resistance * (1.0 + ageing * campaign.duration_s / 3600.0)
    shift_K = abs(drift) * turn_s / 3600.0 + abs(offset_K)
    room = bath_reach(inflows, (resistance, aged), shift_K)
    return BathScenario(
        seed=seed,
        duration_s=campaign.duration_s,
        volumes_gal=volumes_gal,
        fill_times_s=fill_times_s,
        fill_s=_uniform(generator, water.fill_s),
        inflows=inflows,
        inflow_times_s=_times_s(generator, moves, water.quiet_s, campaign.duration_s),
        drift_K_per_h=drift,
        turn_s=turn_s,
        resistance=resistance,
        ageing_per_h=ageing,
        reference=_waveform(generator, campaign.reference, room),
        constant=bool(generator.random() < campaign.reference.constant),
        sigma_K=_uniform(generator, sensor.sigma_K),
        spike_share=_uniform(generator, sensor.spike_share),
        spike_K=sensor.spike_K,
        output_K=_uniform(generator, sensor.output_K),
        offset_K=offset_K,
        output_delay_ticks=_whole(generator, sensor.output_delay_ticks),
        line_voltage=_uniform(generator, campaign.line.voltage),
        frequency_Hz=_uniform(generator, campaign.line.frequency_Hz),
        voltage_V=_uniform(generator, wire.voltage_V),
        power_W=_uniform(generator, wire.power_W),
        scale_S=_uniform(generator, wire.scale_S),
    )


def _waveform(
    generator: np.random.Generator, ranges: BathReferenceRanges, room: tuple[float, float]
) -> Waveform:
    """Draw a waveform and move it into what V_c holds."""
    shape = ranges.shapes[int(generator.integers(len(ranges.shapes)))]
    least, most = room
    height = min(_uniform(generator, ranges.step), most - least)
    wanted = ranges.low + _uniform(generator, ranges.low_above)
    low = min(max(wanted, least), most - height)
    period_s = float(round(_uniform(generator, ranges.period_s)))
    return Waveform(Shape(shape), low, low + height, period_s)


def _volumes(
    generator: np.random.Generator, water: WaterRanges, duration_s: float
) -> tuple[Numbers, Numbers]:
    volumes = [_uniform(generator, water.volume_gal)]
    if generator.random() < water.unchanged:
        return tuple(volumes), ()
    count = _whole(generator, water.fills)
    for _ in range(count):
        volumes.append(_other_volume(generator, water, volumes[-1]))
    return tuple(volumes), _times_s(generator, count, water.quiet_s, duration_s)


def _other_volume(generator: np.random.Generator, water: WaterRanges, present: float) -> float:
    """Return a volume that differs by the least factor, in either direction."""
    low, high = water.volume_gal
    below, above = present / water.fill_min, present * water.fill_min
    room_below, room_above = max(0.0, below - low), max(0.0, high - above)
    if room_below + room_above == 0.0:
        return low if present > 0.5 * (low + high) else high
    place = generator.uniform(0.0, room_below + room_above)
    return float(low + place if place < room_below else above + place - room_below)


def _times_s(
    generator: np.random.Generator, count: int, quiet_s: float, duration_s: float
) -> Numbers:
    end_s = max(quiet_s, duration_s - quiet_s)
    return tuple(np.sort(np.round(generator.uniform(quiet_s, end_s, count))).tolist())


def _uniform(generator: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(generator.uniform(*ends))


def _whole(generator: np.random.Generator, ends: tuple[int, int]) -> int:
    return int(generator.integers(ends[0], ends[1] + 1))
