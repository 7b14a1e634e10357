"""Runs of motors and of baths: what a seed draws, and plant, controller and course made of it."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from adaptdrive.control.loads.bath import realise
from adaptdrive.control.loads.load import Load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.signals import Shape, Waveform
from adaptdrive_sim.campaign import drawn, settings
from adaptdrive_sim.course import Array, Course, moving
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.boost import CouplingParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import World


@dataclass(frozen=True, slots=True)
class Life:
    """Drawn values; torques and friction are in volts of V_c that the motor needs for them.

    Attributes:
        torque_times_s: When the load torque begins to move.
        torques_V: Where it moves to.
        torque_ramps_s: How long each movement takes.
        inertia_ramps_s: How long each change of the inertia takes.
        idle_times_s: When the reference stops where it is.
        idle_s: How long each time.
        stop_times_s: When the drive is disabled.
        off_s: For how long.
        coulomb_V: Dry friction.
        drag_V: Drag in the middle of the range.
        offset: What the tachometer shows at a standstill.
    """

    torque_times_s: drawn.Numbers = ()
    torques_V: drawn.Numbers = ()
    torque_ramps_s: drawn.Numbers = ()
    inertia_ramps_s: drawn.Numbers = ()
    idle_times_s: drawn.Numbers = ()
    idle_s: drawn.Numbers = ()
    stop_times_s: drawn.Numbers = ()
    off_s: drawn.Numbers = ()
    coulomb_V: float = 0.0
    drag_V: float = 0.0
    offset: float = 0.0

    @property
    def largest_torque_V(self) -> float:
        """Largest load torque of the run."""
        return max(self.torques_V, default=0.0)

    def torques_at(self, times_s: Array) -> Array:
        """Load torque in N m at each time; empty where there is none in the whole run."""
        if not self.torques_V:
            return np.empty(0)
        levels_V = (0.0, *self.torques_V)
        return volt_Nm() * moving(times_s, self.torque_times_s, levels_V, self.torque_ramps_s)

    def stops(self, period_s: float) -> tuple[range, ...]:
        """Return the slow periods in which the drive is off."""
        starts = [round(time_s / period_s) for time_s in self.stop_times_s]
        lengths = [max(2, round(length_s / period_s)) for length_s in self.off_s]
        return tuple(range(k, k + n) for k, n in zip(starts, lengths, strict=True))

    def held_at(self, times_s: Array) -> Array:
        """Return the times at which the reference is read: they stand still in idle phases."""
        found = times_s.copy()
        for start_s, length_s in zip(self.idle_times_s, self.idle_s, strict=True):
            found[(times_s >= start_s) & (times_s < start_s + length_s)] = start_s
        return found


def volt_Nm() -> float:
    """Torque at the shaft that takes a volt of V_c."""
    stage, motor = CouplingParameters(), MotorParameters()
    return stage.ratio * motor.constant_Vs / (stage.droop_Ohm + motor.resistance_Ohm)


def draw_life(ranges: settings.LifeRanges, seed: int, duration_s: float, changes: int) -> Life:
    """Draw what happens in the run of a seed.

    Args:
        ranges: What to draw from.
        seed: Of the run.
        duration_s: Its length.
        changes: How often its inertia changes.
    """
    # a separate stream: a file without [life] draws the same
    rng = np.random.default_rng([seed, 3])
    torques = drawn.whole(rng, ranges.torque_changes)
    phases = drawn.whole(rng, ranges.idle)
    restarts = int(rng.random() < ranges.restarted)
    constant = rng.random() < ranges.constant
    return Life(
        torque_times_s=drawn.times(rng, torques, 0.0, duration_s),
        torques_V=_several(rng, torques, ranges.torque_V),
        torque_ramps_s=_ramps_s(rng, torques, ranges.torque_ramp_s, ranges.sudden),
        inertia_ramps_s=_ramps_s(rng, changes, ranges.inertia_ramp_s, ranges.sudden),
        idle_times_s=(0.0,) if constant else drawn.times(rng, phases, 0.0, duration_s),
        idle_s=(np.inf,) if constant else _several(rng, phases, ranges.idle_s),
        stop_times_s=_several(rng, restarts, (0.2 * duration_s, 0.8 * duration_s)),
        off_s=_several(rng, restarts, ranges.off_s),
        coulomb_V=drawn.uniform(rng, ranges.coulomb_V),
        drag_V=drawn.uniform(rng, ranges.drag_V),
        offset=drawn.uniform(rng, ranges.offset),
    )


def _ramps_s(
    rng: np.random.Generator, count: int, ends: settings.Range, sudden: float
) -> drawn.Numbers:
    ramps_s, jumps = rng.uniform(*ends, count), rng.random(count) < sudden
    return tuple(np.where(jumps, 0.0, ramps_s).tolist())


def _several(rng: np.random.Generator, count: int, ends: settings.Range) -> drawn.Numbers:
    return tuple(rng.uniform(*ends, count).tolist())


# Runs of motors: what a seed draws, and plant, controller and course made of it.


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario(drawn.Drawn):
    """Drawn values of a run of a motor.

    Attributes:
        inertias: Inertia in disks, first the initial one.
        change_times_s: When it changes.
        gain: Of the tachometer, relative.
        filter: Time constant of its filter, relative.
        life: What happens besides.
        preview: Whether the adaptive controller receives the set-points to come.
    """

    inertias: drawn.Numbers
    change_times_s: drawn.Numbers
    gain: float
    filter: float
    life: Life
    preview: bool = False

    def motor(self) -> MotorParameters:
        """The true motor, with one disk."""
        nominal = MotorParameters()
        return MotorParameters(
            tachometer_Vs=nominal.tachometer_Vs * self.gain,
            filter_s=nominal.filter_s * self.filter,
            coulomb_Nm=self.life.coulomb_V * volt_Nm(),
            drag_Nms2=self.life.drag_V * volt_Nm() * (nominal.tachometer_Vs / settings.MIDDLE) ** 2,
        )


def draw(campaign: settings.Campaign, seed: int) -> Scenario:
    """The run of a campaign that a seed stands for."""
    rng = np.random.default_rng([seed, 0])
    load, reference, noise = campaign.load, campaign.reference, campaign.noise
    unchanged = load.unchanged if campaign.duration_s > 2.0 * load.quiet_s else 1.0
    inertias = drawn.several_sizes(rng, load.inertia, unchanged, load.changes, load.change_min)
    end_s = max(load.quiet_s, campaign.duration_s - load.quiet_s)
    times_s = drawn.times(rng, len(inertias) - 1, load.quiet_s, end_s)
    step = drawn.uniform(rng, reference.step)
    shape = reference.shapes[int(rng.integers(len(reference.shapes)))]
    period_s = round(drawn.uniform(rng, reference.period_s))
    line, wire = campaign.line, campaign.wire
    gain = drawn.uniform(rng, load.gain)
    # from a separate stream, so that a file without it draws the same as ever
    above = drawn.uniform(np.random.default_rng([seed, 2]), reference.low_above)
    life = draw_life(campaign.life, seed, campaign.duration_s, len(times_s))
    held = settings.reach(gain, life.largest_torque_V + life.coulomb_V, life.drag_V)
    low, high = drawn.within_reach(reference.low + above, step, held)
    return Scenario(
        seed=seed,
        duration_s=campaign.duration_s,
        inertias=inertias,
        change_times_s=times_s,
        gain=gain,
        filter=drawn.uniform(rng, load.filter),
        reference=Waveform(Shape(shape), low, high, float(period_s)),
        sigma=(high - low) * drawn.uniform(rng, noise.sigma),
        spike_share=drawn.uniform(rng, noise.spike_share),
        spike_sigma=(high - low) * noise.spike_sigma,
        line_voltage=drawn.uniform(rng, line.voltage),
        frequency_Hz=drawn.uniform(rng, line.frequency_Hz),
        output_delay_ticks=drawn.whole(rng, wire.output_delay_ticks),
        output_quantum=drawn.uniform(rng, wire.output_V),
        **drawn.each(rng, wire, "voltage_V", "power_W", "scale_S"),
        life=life,
        preview=reference.preview,
    )


@cache
def deployed() -> drawn.Deployed:
    """The example configuration, for a run that starts at rest."""
    return drawn.at_rest(drawn.deploy("motor.toml"))


class Stand(drawn.DrawnRun):
    """The course of one scenario of a motor; its size is the inertia in disks."""

    def __init__(self, scenario: Scenario) -> None:
        life = scenario.life
        super().__init__(deployed(), scenario, scenario.reference.value(0.0))
        self.scenario = scenario
        starts_s, ramps_s = scenario.change_times_s, life.inertia_ramps_s
        self.sizes = moving(self.times_s, starts_s, scenario.inertias, ramps_s)
        self.change_times_s = starts_s
        moved = settings.NOMINAL_GAIN * scenario.gain * life.largest_torque_V
        self.largest_movement = max(self.step, moved)
        self.plan = Course(
            references=scenario.references_at(life.held_at(self.times_s)),
            sizes=self.sizes,
            disturbances=life.offset + scenario.disturbances(self.ticks + 1),
            burdens=life.torques_at(self.times_s),
            offset=life.offset,
            stops=life.stops(self.own.period_s),
            preview=scenario.preview,
        )
        self._true_load = cache(self._load_with)

    def columns(self) -> drawn.Row:
        """Return the drawn values as columns of the results; noise is relative to the step."""
        return super().columns() | {"sigma": self.scenario.sigma / self.step}

    def world(self) -> World:
        """Return the plant as it is at the start."""
        motor = Motor(self.scenario.motor())
        motor.resize(float(self.sizes[0]), 0.0)
        return World(motor, line=self.scenario.line())

    def true_load(self, k: int) -> Load:
        """Return the model of the true motor in a slow period."""
        return self._true_load(float(self.sizes[k]))

    def _load_with(self, inertia: float) -> Load:
        motor, coupling = Motor(self.scenario.motor()), CouplingParameters()
        motor.set_inertia(MotorParameters().disk_kgm2 * inertia)
        reference = self.scenario.reference
        middle = 0.5 * (reference.low + reference.high) - self.plan.offset
        motor.speed_rad_s = middle / motor.parameters.tachometer_Vs
        model = motor.model(coupling.ratio, coupling.droop_Ohm)
        return motor_load(model["gain"], model["tau_motor_s"], model["tau_filter_s"])


# Runs of baths: what a seed draws, and plant, controller and course made of it.


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
    rng = np.random.default_rng([seed, 4])
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
        super().__init__(deployed_bath(), scenario, scenario.reference.low)
        self.scenario = scenario
        self.change_times_s = scenario.fill_times_s
        flows, volumes_gal = scenario.inflows, scenario.volumes_gal
        self.sizes = moving(self.times_s, self.change_times_s, volumes_gal, scenario.fill_s)
        self.inflows = moving(self.times_s, scenario.inflow_times_s, flows)
        low = np.full(self.times_s.size, scenario.reference.low)
        self.plan = Course(
            references=low if scenario.constant else scenario.references_at(self.times_s),
            sizes=moving(self.times_s, self.change_times_s, volumes_gal) / volumes_gal[0],
            over_s=scenario.fill_s,
            disturbances=scenario.disturbances(self.ticks + 1, scenario.offset_K),
            burdens=self.inflows / flows[0] if scenario.inflow_times_s else np.empty(0),
            offset=scenario.offset_K,
        )
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
        return World(Bath(parameters), line=scenario.line())

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
