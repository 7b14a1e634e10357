"""The shape that every simulated load shares, and the one that a configuration describes.

Seen from the secondary of the dc/dc stage a load is an electromotive force behind a resistance;
what happens behind them (a turning shaft, warming water, a filling battery) is its own affair.
The boost stage needs only those two numbers, and the load needs only the source that feeds it.

Its linear model is that of `[load.model]`. What a model leaves open, such as the resistance of a
motor's armature, is that of the reference load, or is named in `[simulation.parameters]`.
"""

import dataclasses
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, TypeVar

from adaptdrive.config import Configuration
from adaptdrive.config.load import BathModel, BathSection, BatterySection, MotorModel, MotorSection
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.plants import bath, battery, boost, motor

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


def load_of(configuration: Configuration, disks: int | None = None) -> SimulatedLoad:
    """Build the load of a configuration.

    Args:
        configuration: `[load]` and `[simulation]`.
        disks: Disks on the shaft of a motor, None for one.

    Raises:
        ParameterError: A parameter lies outside its range.
        RefusedError: `[simulation.parameters]` or the number of disks does not fit the load.
    """
    section, stage = configuration.load, coupling_of(configuration)
    given = _split(configuration.simulation.parameters)[1]
    if disks is not None and not isinstance(section, MotorSection):
        raise RefusedError(f"--disks {disks}: a {section.type} has no shaft")
    match section:
        case MotorSection(model=model):
            known = _motor(_with(motor.MotorParameters(), given), model, stage)
            return motor.Motor(_with(known, given), 1 if disks is None else disks)
        case BathSection(model=model):
            return bath.Bath(_with(_bath(model), given))
        case BatterySection():
            return battery.Battery(_with(_battery(section), given))


def coupling_of(configuration: Configuration) -> boost.CouplingParameters:
    """Build the dc/dc stage of a configuration.

    Raises:
        ParameterError: A parameter lies outside its range.
    """
    section, given = configuration.load, _split(configuration.simulation.parameters)[0]
    if isinstance(section, MotorSection):
        return _with(boost.CouplingParameters(), given)
    model = section.model
    return _with(boost.CouplingParameters(model.turns_ratio, model.droop_Ohm), given)


def _motor(
    known: motor.MotorParameters, model: MotorModel, stage: boost.CouplingParameters
) -> motor.MotorParameters:
    """Return a motor with the inertia, tachometer and filter that a model needs."""
    total_Ohm, constant_Vs = stage.droop_Ohm + known.resistance_Ohm, known.constant_Vs
    damping_Nms = known.friction_Nms + constant_Vs**2 / total_Ohm
    return dataclasses.replace(
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
    names = {field.name for field in dataclasses.fields(boost.CouplingParameters)}
    stage = {name: value for name, value in given.items() if name in names}
    return stage, {name: value for name, value in given.items() if name not in names}


def _with(parameters: Parameters, given: Mapping[str, float]) -> Parameters:
    """Return parameters with some of them replaced.

    Raises:
        RefusedError: A name is none of theirs.
    """
    types = {field.name: field.type for field in dataclasses.fields(parameters)}
    for name in given:
        if name not in types:
            near = get_close_matches(name, types, 1) or [", ".join(types)]
            raise RefusedError(f"simulation.parameters.{name}: is not known; {near[0]}?")
    whole = {n: _WHOLE.get(str(types[n]), float)(v) for n, v in given.items()}
    made: Parameters = dataclasses.replace(parameters, **whole)
    return made
