"""The simulated plant as a whole, stepped by one half line cycle at a time.

Between the frames n and n+1 the world runs one interval. `step` takes the command that was
computed from frame n, runs that interval under the command *before* it, and returns frame n+1:
the drive latches a command at the end of the half cycle in which it arrives. This is the one
half cycle of delay between a frame and the command's effect, and it exists nowhere else.
"""

from dataclasses import dataclass, field

import numpy as np

from adaptdrive_sim import wire
from adaptdrive_sim.parameters import SEED_MAX, ParameterError, check_range
from adaptdrive_sim.plants import boost as stage
from adaptdrive_sim.plants.boost import Sample
from adaptdrive_sim.plants.load import SimulatedLoad


@dataclass(frozen=True, slots=True)
class WorldParameters:
    """Everything but the load.

    Attributes:
        line: The ac line.
        boost: The boost stage.
        coupling: The dc/dc stage.
        noise: Measurement noise of the output.
        sampling_phase_rad: Where in the ripple the boost voltage is sampled, as a phase of the
            line's double frequency; 0 is the zero crossing, where the ripple vanishes.
        seed: Seed of the noise.
    """

    line: stage.LineParameters = field(default_factory=stage.LineParameters)
    boost: stage.BoostParameters = field(default_factory=stage.BoostParameters)
    coupling: stage.CouplingParameters = field(default_factory=stage.CouplingParameters)
    noise: wire.NoiseParameters = field(default_factory=wire.NoiseParameters)
    sampling_phase_rad: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_range("seed", self.seed, 0, SEED_MAX, "")


class World:
    """Line, boost stage, dc/dc stage and load."""

    def __init__(self, load: SimulatedLoad, parameters: WorldParameters | None = None) -> None:
        """Join a load to a drive whose capacitor is charged to the line's peak.

        Args:
            load: Any simulated load, in whatever state it is.
            parameters: The drive; the reference plant when left out.
        """
        self.parameters = parameters or WorldParameters()
        self.load = load
        self.line = stage.Line(self.parameters.line)
        self.coupling = self.parameters.coupling
        self.boost = stage.Boost(self.parameters.boost, self.parameters.line.voltage_V * 2.0**0.5)
        self.tick = 0
        self.load_current_A = 0.0
        self.current_scale_S = 0.0
        self.bridge = False
        self.sensor_fault = 0
        self._generator = np.random.default_rng(self.parameters.seed)
        self.noise = self.parameters.noise

    @property
    def noise(self) -> wire.NoiseParameters:
        """Measurement noise of the output; may be changed at any time."""
        return self._noise

    @noise.setter
    def noise(self, noise: wire.NoiseParameters) -> None:
        self._noise = noise
        self._draws = None if noise.silent else wire.samples(noise, self._generator)

    @property
    def true_output(self) -> float:
        """The regulated quantity without measurement noise."""
        return self.load.output

    @property
    def true_model(self) -> dict[str, float]:
        """Parameters of the load's linear model, by formula."""
        return self.load.model(self.coupling.ratio, self.coupling.droop_Ohm)

    def truth(self) -> dict[str, float]:
        """The true state and parameters, for comparison with measurements and estimates."""
        return {
            "tick": self.tick,
            "half_cycle_s": self.line.half_cycle_s,
            **self.load.state(),
            **self.true_model,
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
            raise ParameterError("boost_voltage_V", boost_voltage_V, rule)
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

    def step(self, current_scale_S: float, bridge: bool) -> Sample:
        """Run one half cycle under the latched command, then latch the given one.

        Args:
            current_scale_S: Line-current scale k computed from the last frame.
            bridge: Whether the bridge may feed the load, as above.

        Returns:
            The frame at the end of the half cycle.
        """
        disturbance = 0.0 if self._draws is None else next(self._draws)
        return self.step_disturbed(current_scale_S, bridge, disturbance)

    def step_disturbed(self, current_scale_S: float, bridge: bool, disturbance: float) -> Sample:
        """Run one half cycle like `step`, with a given measurement noise."""
        line, boost = self.line, self.boost
        line.advance()
        duration_s = line.half_cycle_s
        boost_V = self._run(line.voltage_V, duration_s)
        if self.parameters.sampling_phase_rad:
            boost_V += boost.ripple_V(self.parameters.sampling_phase_rad, duration_s)
        self.tick += 1
        self.current_scale_S = current_scale_S
        self.bridge = bridge
        load_W, output = boost.mean_load_W, self.load.output + disturbance
        line_V, current_A = line.voltage_V, self.load_current_A
        return Sample(self.tick, duration_s, boost_V, line_V, load_W, output, current_A)

    def _run(self, line_V: float, duration_s: float) -> float:
        """Advance boost stage and load under the latched command."""
        load, boost, scale_S = self.load, self.boost, self.current_scale_S
        if not self.bridge:
            load.coast(duration_s)
            self.load_current_A = 0.0
            return boost.advance(scale_S, line_V, 0.0, 0.0, duration_s)
        emf_V = load.emf_V
        conductance_S, offset_A = self.coupling.draw(emf_V, load.resistance_Ohm)
        end_V = boost.advance(scale_S, line_V, conductance_S, offset_A, duration_s)
        source_V = self.coupling.ratio * boost.mean_voltage_V
        if source_V > emf_V or self.parameters.boost.bidirectional:
            self.load_current_A = load.drive(source_V, self.coupling.droop_Ohm, duration_s)
        else:
            load.coast(duration_s)
            self.load_current_A = 0.0
        return end_V
