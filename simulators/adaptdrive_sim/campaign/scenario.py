"""One run of a campaign: everything it depends on is drawn from its seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive_sim.campaign.life import Life, draw_life, moving, volt_Nm
from adaptdrive_sim.campaign.reach import MIDDLE, NOMINAL_GAIN, reach
from adaptdrive_sim.campaign.settings import Campaign, LoadRanges, ReferenceRanges
from adaptdrive_sim.compiled.wire import DELAY_MAX, Wire
from adaptdrive_sim.line import LineParameters
from adaptdrive_sim.plants.motor import MotorParameters

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Scenario:
    """Drawn values of a run.

    Attributes:
        seed: It was drawn from this.
        duration_s: Length.
        inertias: Inertia in disks, first the initial one.
        change_times_s: When it changes.
        gain: Of the tachometer, relative.
        filter: Time constant of its filter, relative.
        reference: The set-point.
        sigma: Noise of every sample, in the unit of the output.
        spike_share: Share of spikes.
        spike_sigma: Noise of the spikes, in the unit of the output.
        line_voltage: Relative line voltage.
        frequency_Hz: Of the line.
        output_delay_ticks: Age of the output's samples.
        output_V: Resolution of the output.
        voltage_V: Resolution of voltages.
        power_W: Resolution of the load power.
        scale_S: Resolution of the current scale.
        life: What happens besides.
    """

    seed: int
    duration_s: float
    inertias: tuple[float, ...]
    change_times_s: tuple[float, ...]
    gain: float
    filter: float
    reference: Waveform
    sigma: float
    spike_share: float
    spike_sigma: float
    line_voltage: float
    frequency_Hz: float
    output_delay_ticks: int
    output_V: float
    voltage_V: float
    power_W: float
    scale_S: float
    life: Life

    @property
    def step(self) -> float:
        """Height of the reference's step."""
        return self.reference.high - self.reference.low

    @property
    def largest_movement(self) -> float:
        """Movement of the output by the reference's step or by the largest load torque."""
        return max(self.step, NOMINAL_GAIN * self.gain * self.life.largest_torque_V)

    def inertias_at(self, times_s: Array) -> Array:
        """Inertia in disks at each time."""
        return moving(times_s, self.change_times_s, self.inertias, self.life.inertia_ramps_s)

    def references_at(self, times_s: Array) -> Array:
        """Return the set-point at each time."""
        read_s = self.life.held_at(times_s).tolist()
        return np.array([self.reference.value(time_s) for time_s in read_s])

    def disturbances(self, count: int) -> Array:
        """Measurement noise of every tick."""
        generator = np.random.default_rng([self.seed, 1])
        noise = self.sigma * generator.standard_normal(count)
        if self.spike_share > 0.0:
            struck = np.flatnonzero(generator.random(count) < self.spike_share)
            noise[struck] += self.spike_sigma * generator.standard_normal(struck.size)
        return noise

    def motor(self) -> MotorParameters:
        """The true motor, with one disk."""
        nominal = MotorParameters()
        return MotorParameters(
            tachometer_Vs=nominal.tachometer_Vs * self.gain,
            filter_s=nominal.filter_s * self.filter,
            coulomb_Nm=self.life.coulomb_V * volt_Nm(),
            drag_Nms2=self.life.drag_V * volt_Nm() * (nominal.tachometer_Vs / MIDDLE) ** 2,
        )

    def columns(self) -> dict[str, Any]:
        """Return the drawn values as columns of the results."""
        return {
            "seed": self.seed,
            "inertia_first": self.inertias[0],
            "inertia_last": self.inertias[-1],
            "inertia_largest": max(self.inertias),
            "changes": len(self.change_times_s),
            "gain": self.gain,
            "filter": self.filter,
            "shape": self.reference.shape.value,
            "step": self.step,
            "period_s": self.reference.period_s,
            "sigma": self.sigma / self.step,
            "spike_share": self.spike_share,
            "line_voltage": self.line_voltage,
            "frequency_Hz": self.frequency_Hz,
            "output_delay_ticks": self.output_delay_ticks,
            "torque_changes": len(self.life.torques_V),
            "torque_largest_V": self.life.largest_torque_V,
            "restarts": len(self.life.stop_times_s),
            "idle_s": min(self.duration_s, sum(self.life.idle_s)),
            "coulomb_V": self.life.coulomb_V,
            "drag_V": self.life.drag_V,
            "offset": self.life.offset,
        }

    def line(self) -> LineParameters:
        """The true line."""
        return LineParameters.steady(self.line_voltage, self.frequency_Hz)

    def wire(self) -> Wire:
        """Return the connection between drive and controller, at rest."""
        return Wire(
            output_quantum=self.output_V,
            voltage_quantum_V=self.voltage_V,
            power_quantum_W=self.power_W,
            scale_quantum_S=self.scale_S,
            output_delay=self.output_delay_ticks,
            outputs=[self.reference.value(0.0)] * (DELAY_MAX + 1),
        )


def draw(campaign: Campaign, seed: int) -> Scenario:
    """The run of a campaign that a seed stands for."""
    generator = np.random.default_rng([seed, 0])
    load, reference, noise = campaign.load, campaign.reference, campaign.noise
    inertias, times_s = _inertias(generator, load, campaign.duration_s)
    step = _uniform(generator, reference.step)
    shape = reference.shapes[int(generator.integers(len(reference.shapes)))]
    period_s = round(_uniform(generator, reference.period_s))
    line, wire = campaign.line, campaign.wire
    gain, above = _uniform(generator, load.gain), _low_above(reference, seed)
    life = draw_life(campaign.life, seed, campaign.duration_s, len(times_s))
    low, high = _reachable(reference.low + above, step, gain, life)
    return Scenario(
        seed=seed,
        duration_s=campaign.duration_s,
        inertias=inertias,
        change_times_s=times_s,
        gain=gain,
        filter=_uniform(generator, load.filter),
        reference=Waveform(Shape(shape), low, high, float(period_s)),
        sigma=(high - low) * _uniform(generator, noise.sigma),
        spike_share=_uniform(generator, noise.spike_share),
        spike_sigma=(high - low) * noise.spike_sigma,
        line_voltage=_uniform(generator, line.voltage),
        frequency_Hz=_uniform(generator, line.frequency_Hz),
        output_delay_ticks=_whole(generator, wire.output_delay_ticks),
        output_V=_uniform(generator, wire.output_V),
        voltage_V=_uniform(generator, wire.voltage_V),
        power_W=_uniform(generator, wire.power_W),
        scale_S=_uniform(generator, wire.scale_S),
        life=life,
    )


def _low_above(reference: ReferenceRanges, seed: int) -> float:
    """Draw from a stream of its own, so that a file without it draws what it always drew."""
    return _uniform(np.random.default_rng([seed, 2]), reference.low_above)


def _reachable(low: float, step: float, gain: float, life: Life) -> tuple[float, float]:
    """Move the set-points of a step into what V_c holds."""
    brake_V = life.largest_torque_V + life.coulomb_V
    least, most = reach(gain, brake_V, life.drag_V)
    height = min(step, most - least)
    moved = min(max(low, least), most - height)
    return (low, low + step) if (moved, height) == (low, step) else (moved, moved + height)


def _inertias(
    generator: np.random.Generator, load: LoadRanges, duration_s: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    inertias = [_uniform(generator, load.inertia)]
    if generator.random() < load.unchanged or duration_s <= 2.0 * load.quiet_s:
        return tuple(inertias), ()
    count = _whole(generator, load.changes)
    for _ in range(count):
        inertias.append(_other_inertia(generator, load, inertias[-1]))
    times_s = generator.uniform(load.quiet_s, duration_s - load.quiet_s, count)
    return tuple(inertias), tuple(sorted(np.round(times_s).tolist()))


def _other_inertia(generator: np.random.Generator, load: LoadRanges, present: float) -> float:
    """Return an inertia that differs by the least factor, in either direction."""
    low, high = load.inertia
    below, above = present / load.change_min, present * load.change_min
    room_below, room_above = max(0.0, below - low), max(0.0, high - above)
    if room_below + room_above == 0.0:
        return low if present > 0.5 * (low + high) else high
    place = generator.uniform(0.0, room_below + room_above)
    return float(low + place if place < room_below else above + place - room_below)


def _uniform(generator: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(generator.uniform(*ends))


def _whole(generator: np.random.Generator, ends: tuple[int, int]) -> int:
    return int(generator.integers(ends[0], ends[1] + 1))
