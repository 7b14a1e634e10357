"""Runs of baths: what a seed draws, and plant, controller and course made of it."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from adaptdrive.control.loads.bath import realise
from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Shape, Waveform
from adaptdrive_sim.campaign import drawn, settings
from adaptdrive_sim.course import moving
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.boost import CouplingParameters
from adaptdrive_sim.world import World, WorldParameters

_STREAM = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class BathScenario(drawn.Drawn):
    """Drawn values of a run of a bath.

    Attributes:
        volumes_gal: Volume, first the initial one.
        fill_times_s: When it begins to change.
        fill_s: How long each change takes.
        inflows: Flow, relative to the model's, first the initial one.
        inflow_times_s: When it changes.
        drift_K_per_h: Drift of the inflow's temperature at the start.
        turn_s: After which it turns.
        resistance: Of the heater at the start, relative to the model's.
        ageing_per_h: Rise of that by ageing, as a share of the resistance at the start.
        constant: Whether the set-point stays at its low end.
        offset_K: Of the sensor.
    """

    volumes_gal: drawn.Numbers
    fill_times_s: drawn.Numbers
    fill_s: float
    inflows: drawn.Numbers
    inflow_times_s: drawn.Numbers
    drift_K_per_h: float
    turn_s: float
    resistance: float
    ageing_per_h: float
    constant: bool
    offset_K: float


def draw_bath(campaign: settings.BathCampaign, seed: int) -> BathScenario:
    """The run of a campaign that a seed stands for."""
    rng = np.random.default_rng([seed, _STREAM])
    water, sensor = campaign.water, campaign.sensor
    quiet_s, end_s = water.quiet_s, max(water.quiet_s, campaign.duration_s - water.quiet_s)
    ends_gal, unchanged = water.volume_gal, water.unchanged
    volumes_gal = drawn.several_sizes(rng, ends_gal, unchanged, water.fills, water.fill_min)
    fill_times_s = drawn.times(rng, len(volumes_gal) - 1, quiet_s, end_s)
    moves = drawn.whole(rng, water.inflow_changes)
    inflows = tuple(drawn.uniform(rng, water.inflow) for _ in range(moves + 1))
    drift = drawn.uniform(rng, water.drift_K_per_h) * float(rng.choice((-1.0, 1.0)))
    turn_s = drawn.uniform(rng, water.turn_s)
    offset_K = drawn.uniform(rng, sensor.offset_K)
    resistance = drawn.uniform(rng, campaign.heater.resistance)
    ageing = drawn.uniform(rng, campaign.heater.ageing_per_h)
    aged = resistance * (1.0 + ageing * campaign.duration_s / 3600.0)
    shift_K = abs(drift) * turn_s / 3600.0 + abs(offset_K)
    room = settings.bath_reach(inflows, (resistance, aged), shift_K)
    return BathScenario(
        seed=seed,
        duration_s=campaign.duration_s,
        volumes_gal=volumes_gal,
        fill_times_s=fill_times_s,
        fill_s=drawn.uniform(rng, water.fill_s),
        inflows=inflows,
        inflow_times_s=drawn.times(rng, moves, quiet_s, end_s),
        drift_K_per_h=drift,
        turn_s=turn_s,
        resistance=resistance,
        ageing_per_h=ageing,
        reference=_waveform(rng, campaign.reference, room),
        constant=bool(rng.random() < campaign.reference.constant),
        sigma=drawn.uniform(rng, sensor.sigma_K),
        spike_share=drawn.uniform(rng, sensor.spike_share),
        spike_sigma=sensor.spike_K,
        output_quantum=drawn.uniform(rng, sensor.output_K),
        offset_K=offset_K,
        output_delay_ticks=drawn.whole(rng, sensor.output_delay_ticks),
        line_voltage=drawn.uniform(rng, campaign.line.voltage),
        frequency_Hz=drawn.uniform(rng, campaign.line.frequency_Hz),
        **drawn.each(rng, campaign.wire, "voltage_V", "power_W", "scale_S"),
    )


def _waveform(
    rng: np.random.Generator, ranges: settings.BathReferenceRanges, room: settings.Range
) -> Waveform:
    """Draw a waveform and move it into what V_c holds."""
    shape = ranges.shapes[int(rng.integers(len(ranges.shapes)))]
    step = drawn.uniform(rng, ranges.step)
    low = ranges.low + drawn.uniform(rng, ranges.low_above)
    ends = drawn.within_reach(low, step, room)
    return Waveform(Shape(shape), *ends, float(round(drawn.uniform(rng, ranges.period_s))))


@cache
def deployed_bath() -> drawn.Deployed:
    """The example configuration."""
    return drawn.deploy("bath.toml")


class BathStand(drawn.DrawnRun):
    """The course of one scenario of a bath; its size is the volume in US gallons."""

    def __init__(self, scenario: BathScenario) -> None:
        super().__init__(deployed_bath(), scenario, scenario.offset_K, scenario.reference.low)
        self.scenario = scenario
        self.change_times_s = scenario.fill_times_s
        flows, volumes_gal = scenario.inflows, scenario.volumes_gal
        self.sizes = moving(self.times_s, self.change_times_s, volumes_gal, scenario.fill_s)
        self.inflows = moving(self.times_s, scenario.inflow_times_s, flows)
        self.targets = moving(self.times_s, self.change_times_s, volumes_gal) / volumes_gal[0]
        self.over_s = scenario.fill_s
        self.burdens = self.inflows / flows[0] if scenario.inflow_times_s else np.empty(0)
        low = np.full(self.times_s.size, scenario.reference.low)
        self.references = low if scenario.constant else scenario.references_at(self.times_s)
        self.disturbances = scenario.disturbances(self.ticks + 1, self.offset)
        moved_K = (max(flows) / min(flows) - 1.0) * scenario.reference.high
        self.largest_movement = max(self.step, moved_K)

    def columns(self) -> drawn.Row:
        """Return the drawn values as columns of the results."""
        row = super().columns()
        return row | {"shape": "constant"} if self.scenario.constant else row

    def world(self) -> World:
        """Return the plant as it is at the start."""
        scenario = self.scenario
        parameters = replace(
            self._parameters(0),
            drift_K_per_h=scenario.drift_K_per_h,
            turn_s=scenario.turn_s,
            ageing_per_h=scenario.ageing_per_h,
        )
        return World(Bath(parameters), WorldParameters(line=scenario.line()))

    def true_load(self, k: int) -> Load:
        """Return the model of the true bath in a slow period; its input is a new heater's power."""
        stage, nominal = CouplingParameters(), self.own.load
        model = Bath(self._parameters(k)).model(stage.ratio, stage.droop_Ohm)
        power = model["heater_W_per_V2"] / nominal.input_gain
        numerator, denominator = realise([model["resistance_K_per_W"] * power, model["tau_s"]])
        return replace(nominal, numerator=tuple(numerator), denominator=tuple(denominator))

    def _parameters(self, k: int) -> BathParameters:
        """Return the bath as it is in a slow period, without what moves it."""
        scenario = self.scenario
        aged = 1.0 + scenario.ageing_per_h * float(self.times_s[k]) / 3600.0
        volume = float(self.sizes[k]) / BathParameters().volume_gal
        return settings.bath_parameters(volume, float(self.inflows[k]), scenario.resistance * aged)
