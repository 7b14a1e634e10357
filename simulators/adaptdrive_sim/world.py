"""The simulated plant: its load, its noise, and the whole, stepped by half line cycles.

Between the frames n and n+1 the world runs one interval. `step` takes the command that was
computed from frame n, runs that interval under the command *before* it, and returns frame n+1:
the drive latches a command at the end of the half cycle in which it arrives. This is the one
half cycle of delay between a frame and the command's effect, and it exists nowhere else.

Seen from the secondary of the dc/dc stage a load is an electromotive force behind a resistance;
what happens behind them (a turning shaft, warming water, a filling battery) is its own affair.
The boost stage needs only those two numbers, and the load needs only the source that feeds it.

Its linear model is that of `[load.model]`. What a model leaves open, such as the resistance of a
motor's armature, is that of the reference load, or is named in `[simulation.parameters]`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from typing import Any, Self, TypeVar

import numpy as np

from adaptdrive.config import Configuration
from adaptdrive.config.load import BathModel, BathSection, BatterySection, MotorModel, MotorSection
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.parameters import (
    SEED_MAX,
    ParameterError,
    check_quantities,
    check_range,
    quantity,
)
from adaptdrive_sim.plants import bath, battery, motor
from adaptdrive_sim.plants.boost import (
    Boost,
    BoostParameters,
    CouplingParameters,
    Line,
    LineParameters,
    Sample,
)

# The shape that every simulated load shares, and the one that a configuration describes.

SimulatedLoad = motor.Motor | bath.Bath | battery.Battery
"""One simulated load, stepped by whole half line cycles.

Each has `emf_V` (terminal voltage without current) and `resistance_Ohm`, the regulated `output`
without noise, `drive` and `coast` (advance with a source, and without current), `settle` and
`source_for` (rest under a source, and the source for an output), `model` (the linear model from
boost voltage to output), `state`, and `resize` and `disturb`, which change it.
"""

Parameters = TypeVar("Parameters", bound=Any)

_WHOLE = {"int": int, "bool": bool}

_CELL_MAX_V = 4.10
"""Highest voltage to which a cell is charged."""


def load_of(configuration: Configuration) -> SimulatedLoad:
    """Build the load of a configuration.

    Args:
        configuration: `[load]` and `[simulation]`.

    Raises:
        ParameterError: A parameter lies outside its range.
        RefusedError: `[simulation.parameters]` does not fit the load.
    """
    section, stage = configuration.load, coupling_of(configuration)
    given = _split(configuration.simulation.parameters)[1]
    match section:
        case MotorSection(model=model):
            known = _motor(_with(motor.MotorParameters(), given), model, stage)
            return motor.Motor(_with(known, given))
        case BathSection(model=model):
            return bath.Bath(_with(_bath(model), given))
        case BatterySection():
            return battery.Battery(_with(_battery(section), given))


def coupling_of(configuration: Configuration) -> CouplingParameters:
    """Build the dc/dc stage of a configuration.

    Raises:
        ParameterError: A parameter lies outside its range.
    """
    section, given = configuration.load, _split(configuration.simulation.parameters)[0]
    if isinstance(section, MotorSection):
        return _with(CouplingParameters(), given)
    model = section.model
    return _with(CouplingParameters(model.turns_ratio, model.droop_Ohm), given)


def _motor(
    known: motor.MotorParameters, model: MotorModel, stage: CouplingParameters
) -> motor.MotorParameters:
    """Return a motor with the inertia, tachometer and filter that a model needs."""
    total_Ohm, constant_Vs = stage.droop_Ohm + known.resistance_Ohm, known.constant_Vs
    damping_Nms = known.friction_Nms + constant_Vs**2 / total_Ohm
    return replace(
        known,
        disk_kgm2=model.tau_motor_s * damping_Nms,
        tachometer_Vs=model.gain * damping_Nms * total_Ohm / (stage.ratio * constant_Vs),
        filter_s=model.tau_filter_s,
    )


def _bath(model: BathModel) -> bath.BathParameters:
    """Return a bath with the inflow and the volume that a model needs."""
    heat_W_per_K = 1.0 / model.resistance_K_per_W
    return bath.BathParameters(
        heater_Ohm=model.heater_Ohm,
        inflow_L_per_min=60.0 * heat_W_per_K / bath.HEAT_J_per_kgK,
        volume_gal=model.tau_s * heat_W_per_K / bath.HEAT_J_per_kgK / bath.GALLON_kg,
    )


def _battery(section: BatterySection) -> battery.BatteryParameters:
    """Return a battery with the resistances of a model, and cells for its highest voltage."""
    model = section.model
    return battery.BatteryParameters(
        cells=max(1, round(section.charge.voltage_max_V / _CELL_MAX_V)),
        series_Ohm=model.internal_Ohm,
        relaxation_Ohm=model.relaxation_Ohm,
        relaxation_s=model.relaxation_s,
    )


def _split(given: Mapping[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """Return the values for the dc/dc stage, and those for the load."""
    names = {field.name for field in fields(CouplingParameters)}
    stage = {name: value for name, value in given.items() if name in names}
    return stage, {name: value for name, value in given.items() if name not in names}


def _with(parameters: Parameters, given: Mapping[str, float]) -> Parameters:
    """Return parameters with some of them replaced.

    Raises:
        RefusedError: A name is none of theirs.
    """
    types = {field.name: field.type for field in fields(parameters)}
    for name in given:
        if name not in types:
            near = get_close_matches(name, types, 1) or [", ".join(types)]
            raise RefusedError(f"simulation.parameters.{name}: is not known; {near[0]}?")
    whole = {n: _WHOLE.get(str(types[n]), float)(v) for n, v in given.items()}
    made: Parameters = replace(parameters, **whole)
    return made


# Measurement noise on the output: brush noise and spikes.

_BLOCK = 4096
"""Random numbers drawn at once: one draw for each sample would cost more than the plant."""


@dataclass(frozen=True, slots=True)
class NoiseParameters:
    """Noise of each fast sample, in the unit of the output."""

    sigma: float = quantity(0.0, "", "standard deviation of every sample", 0.0, 1e6)
    spike_share: float = quantity(0.0, "", "share of samples that carry a spike", 0.0, 1.0)
    spike_sigma: float = quantity(0.0, "", "standard deviation of the spikes", 0.0, 1e6)

    def __post_init__(self) -> None:
        check_quantities(self)

    @property
    def silent(self) -> bool:
        """True if no sample is ever disturbed."""
        return self.sigma == 0.0 and (self.spike_share == 0.0 or self.spike_sigma == 0.0)

    def scaled(self, step: float) -> Self:
        """Return the noise in the unit of the output, of one that is relative to a step."""
        return replace(self, sigma=self.sigma * step, spike_sigma=self.spike_sigma * step)


def samples(parameters: NoiseParameters, generator: np.random.Generator) -> Iterator[float]:
    """Yield the disturbance of one sample after the other, for ever."""
    while True:
        block = parameters.sigma * generator.standard_normal(_BLOCK)
        if parameters.spike_share > 0.0:
            struck = generator.random(_BLOCK) < parameters.spike_share
            block += struck * parameters.spike_sigma * generator.standard_normal(_BLOCK)
        yield from block.tolist()


# The plant as a whole.


class World:
    """Line, boost stage, dc/dc stage and load."""

    def __init__(  # noqa: PLR0913 - one parameter for each part
        self,
        load: SimulatedLoad,
        *,
        line: LineParameters | None = None,
        boost: BoostParameters | None = None,
        coupling: CouplingParameters | None = None,
        noise: NoiseParameters | None = None,
        seed: int = 0,
    ) -> None:
        """Join a load to a drive whose capacitor is charged to the line's peak.

        Args:
            load: Any simulated load, in whatever state it is.
            line: The ac line; that of the reference plant when left out, as are the others.
            boost: The boost stage.
            coupling: The dc/dc stage.
            noise: Measurement noise of the output; none when left out.
            seed: Seed of the noise.

        Raises:
            ParameterError: The seed lies outside its range.
        """
        check_range("seed", seed, 0, SEED_MAX, "")
        self.load = load
        self.line = Line(line or LineParameters())
        self.coupling = coupling or CouplingParameters()
        self.boost = Boost(boost or BoostParameters(), self.line.voltage_V * 2.0**0.5)
        self.tick = 0
        self.load_current_A = 0.0
        self.current_scale_S = 0.0
        self.bridge = False
        self.sensor_fault = 0
        self._generator = np.random.default_rng(seed)
        self.set_noise(noise or NoiseParameters())

    def set_noise(self, noise: NoiseParameters) -> None:
        """Let the measurement of the output have a noise from now on."""
        self.noise = noise
        self._draws = None if noise.silent else samples(noise, self._generator)

    @property
    def true_output(self) -> float:
        """The regulated quantity without measurement noise."""
        return self.load.output

    def truth(self) -> dict[str, float]:
        """The true state and parameters, for comparison with measurements and estimates."""
        return {
            "tick": self.tick,
            "half_cycle_s": self.line.half_cycle_s,
            **self.load.state(),
            **self.load.model(self.coupling.ratio, self.coupling.droop_Ohm),
            "output": self.true_output,
            "boost_voltage_V": self.boost.voltage_V,
            "line_voltage_V": self.line.voltage_V,
            "line_power_W": self.boost.mean_line_W,
            "load_current_A": self.load_current_A,
            "noise_V": self.noise.sigma,
        }

    def settle(self, boost_voltage_V: float) -> None:
        """Put everything at rest at a boost voltage, bridge on, with the command that holds it.

        Raises:
            ParameterError: The line's peak lies above that voltage.
        """
        peak_V = self.line.voltage_V * 2.0**0.5 if self.boost.has_rectifier else 0.0
        if not boost_voltage_V >= peak_V:
            rule = f"must be at least the line's peak of {peak_V:.1f} V"
            raise ParameterError(f"boost_voltage_V = {boost_voltage_V!r} {rule}")
        source_V = self.coupling.ratio * boost_voltage_V
        self.load.settle(source_V, self.coupling.droop_Ohm)
        conductance_S, offset_A = self.coupling.draw(self.load.emf_V, self.load.resistance_Ohm)
        primary_A = conductance_S * boost_voltage_V - offset_A
        self.boost.settle(boost_voltage_V, boost_voltage_V * primary_A)
        self.load_current_A = primary_A / self.coupling.ratio
        self.current_scale_S = boost_voltage_V * primary_A / self.line.voltage_V**2
        self.bridge = True

    def boost_voltage_for(self, output: float) -> float:
        """Find the boost voltage at which the load rests with the given output."""
        return self.load.source_for(output, self.coupling.droop_Ohm) / self.coupling.ratio

    def shut(self) -> None:
        """Bring the drive into its safe state now: k = 0, bridge off, no load current."""
        self.current_scale_S = 0.0
        self.bridge = False
        self.load_current_A = 0.0

    def at_rest(self) -> Sample:
        """Return the present measurements, without any time passing."""
        line, boost_V, output = self.line, self.boost.voltage_V, self.load.output
        duration_s, current_A = line.half_cycle_s, self.load_current_A
        return Sample(self.tick, duration_s, boost_V, line.voltage_V, 0.0, output, current_A)

    def step(
        self, current_scale_S: float, bridge: bool, disturbance: float | None = None
    ) -> Sample:
        """Run one half cycle under the latched command, then latch the given one.

        Args:
            current_scale_S: Line-current scale k computed from the last frame.
            bridge: Whether the bridge may feed the load, as above.
            disturbance: Measurement noise; that of the world when left out.

        Returns:
            The frame at the end of the half cycle.
        """
        if disturbance is None:
            disturbance = 0.0 if self._draws is None else next(self._draws)
        line = self.line
        line.advance()
        duration_s = line.half_cycle_s
        boost_V = self._run(line.voltage_V, duration_s)
        self.tick += 1
        self.current_scale_S = current_scale_S
        self.bridge = bridge
        load_W, output = self.boost.mean_load_W, self.load.output + disturbance
        line_V, current_A = line.voltage_V, self.load_current_A
        return Sample(self.tick, duration_s, boost_V, line_V, load_W, output, current_A)

    def _run(self, line_V: float, duration_s: float) -> float:
        """Advance boost stage and load under the latched command."""
        load, boost, emf_V = self.load, self.boost, self.load.emf_V
        drawn = self.coupling.draw(emf_V, load.resistance_Ohm) if self.bridge else (0.0, 0.0)
        end_V = boost.advance(self.current_scale_S, line_V, drawn, duration_s)
        source_V = self.coupling.ratio * boost.mean_voltage_V
        if self.bridge and (source_V > emf_V or boost.parameters.bidirectional):
            self.load_current_A = load.drive(source_V, self.coupling.droop_Ohm, duration_s)
        else:
            load.coast(duration_s)
            self.load_current_A = 0.0
        return end_V
