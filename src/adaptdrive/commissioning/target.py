"""Limits of an experiment: the drive's, the output's, and the movement that was asked for."""

from dataclasses import dataclass

from adaptdrive.app.loads import build_load
from adaptdrive.config.load import BatterySection
from adaptdrive.config.root import Configuration
from adaptdrive.control.loads.load import to_input, to_voltage
from adaptdrive.util.quantity import BOOST, Given

"""Shortest wait for a load of the kind to respond."""

_ONSET_SHARE = 0.5
"""Share of the movement that one step may bring while the onset of the current is looked for."""

_FINEST_STEP = 1.0e-3
"""Share of the voltage range, for a dc/dc stage without a known resistance."""


@dataclass(frozen=True, slots=True)
class Onset:
    """A load that takes no current below its own voltage.

    Attributes:
        turns_ratio: N2, secondary volts per boost volt.
        droop_Ohm: R_d of the dc/dc stage.
        terminal_max_V: Highest voltage at the terminals.
    """

    turns_ratio: float
    droop_Ohm: float
    terminal_max_V: float

    def terminal_V(self, boost_voltage_V: float, current_A: float) -> float:
        """Return the voltage at the terminals."""
        return self.turns_ratio * boost_voltage_V - self.droop_Ohm * current_A


@dataclass(frozen=True, slots=True)
class Target:
    """Limits of an experiment, and the structure of its load.

    Attributes:
        low_V: Lowest V_c, at which the load rests: not below 0.
        high_V: Highest V_c.
        output_max: Highest output that the experiment leads to.
        move: Movement of the output that the experiment aims at.
        first_gain: Guess of the output's movement per unit of the load's input.
        input_gain: u = gain · v^exponent.
        input_exponent: 1 or 2.
        patience_s: Shortest wait for a response.
        name: Name of the output, for people.
        unit: Its unit.
        onset: For a battery: its terminals.
        given: Name and unit of what the drive is commanded, and gives.
    """

    low_V: float
    high_V: float
    output_max: float
    move: float
    first_gain: float
    input_gain: float
    input_exponent: int
    patience_s: float
    name: str
    unit: str
    onset: Onset | None = None
    given: Given = BOOST

    def to_input(self, voltage_V: float) -> float:
        """Return the load's input at a boost voltage."""
        return to_input(voltage_V, self.input_gain, self.input_exponent)

    def raised_V(self, voltage_V: float, step: float) -> float:
        """Return the voltage at which the load's input is a step higher, within the limits."""
        raised_V = to_voltage(self.to_input(voltage_V) + step, self.input_gain, self.input_exponent)
        return min(max(raised_V, self.low_V), self.high_V)

    @property
    def onset_step_V(self) -> float:
        """Step of V_c that raises a battery's current by less than the movement."""
        onset = self.onset
        if onset is None or not onset.droop_Ohm > 0.0:
            return _FINEST_STEP * (self.high_V - self.low_V)
        return _ONSET_SHARE * self.move * onset.droop_Ohm / onset.turns_ratio


def build_target(
    configuration: Configuration, move_share: float, patience_s: float | None = None
) -> Target:
    """Return the limits of an experiment on a configured drive.

    Args:
        configuration: The drive; its `[load.model]` is used for what belongs to the dc/dc stage.
        move_share: Movement of the output as a share of the set-point range.
        patience_s: Shortest wait for a response; that of the kind of load when None.
    """
    section, limits = configuration.load, configuration.drive.limits
    load, high_V = build_load(configuration), limits.boost_reference_max_V
    low_V = max(limits.boost_reference_min_V, 0.0)  # a negative one would drive the load backwards
    ends = [to_input(one, load.input_gain, load.input_exponent) for one in (low_V, high_V)]
    span = section.reference_max - section.reference_min
    return Target(
        low_V=low_V,
        high_V=high_V,
        output_max=section.reference_max,
        move=move_share * span,
        first_gain=span / (ends[1] - ends[0]),
        input_gain=load.input_gain,
        input_exponent=load.input_exponent,
        patience_s=section.traits.patience_s if patience_s is None else patience_s,
        name=section.output_name,
        unit=section.output_unit,
        onset=_onset(configuration),
        given=configuration.drive.given,
    )


def _onset(configuration: Configuration) -> Onset | None:
    section = configuration.load
    if not isinstance(section, BatterySection):
        return None
    model = section.model
    return Onset(model.turns_ratio, model.droop_Ohm, section.charge.voltage_max_V)
