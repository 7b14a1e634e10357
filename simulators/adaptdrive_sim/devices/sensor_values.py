"""Quantities that sensors on other buses can measure on the simulated plant, by name.

The sensors read the same configuration as the daemon: what is called so there is shown so here.
"""

from collections.abc import Iterable, Mapping
from enum import IntEnum
from pathlib import Path

from adaptdrive.util.errors import ConfigurationError, Flaw
from adaptdrive_sim.devices.drive import Frame
from adaptdrive_sim.devices.frames import quantities_of
from adaptdrive_sim.plants import bath, motor
from adaptdrive_sim.plants.load import SimulatedLoad
from adaptdrive_sim.world import World


class SensorFault(IntEnum):
    """Fault of the sensors on other buses."""

    NONE = 0
    OPEN = 1
    FROZEN = 2
    UNPLUGGED = 3


def values_of(world: World, frame: Frame) -> dict[str, float]:
    """Every value that a sensor can measure, in SI.

    Args:
        world: The plant.
        frame: What the drive measured last; its noise is that of the sensors too.
    """
    sample = frame.sample
    source_V = world.coupling.ratio * sample.boost_voltage_V
    values = quantities_of(frame)
    values["load_voltage"] = source_V - world.coupling.droop_Ohm * sample.load_current_A
    values["load_current"] = sample.load_current_A
    return values | _values_of_load(world.load, sample.output)


def check_names(names: Iterable[tuple[str, str]], known: Mapping[str, float], source: Path) -> None:
    """Make sure that the plant has what the sensors are to measure.

    Args:
        names: Place and name of each value.
        known: Values of the plant.
        source: The configuration, for the error message.

    Raises:
        ConfigurationError: It has not; all that is missing is listed.
    """
    choices = ", ".join(sorted(known))
    flaws = [
        Flaw(place, f"the simulated plant has no {name!r}; it has {choices}")
        for place, name in names
        if name not in known
    ]
    if flaws:
        raise ConfigurationError(source, flaws)


def _values_of_load(load: SimulatedLoad, output: float) -> dict[str, float]:
    if isinstance(load, bath.Bath):
        inflow_K = load.inflow_K
        inflow_now_K = inflow_K + load.inflow_shift_K
        return {"inflow_temperature": inflow_now_K, "bath_temperature": inflow_K + output}
    if isinstance(load, motor.Motor):
        return {"tachometer_voltage": output}
    return {}
