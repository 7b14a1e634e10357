"""The cases: a plant, what happens to it, and the part of the run that is judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive_sim.campaign.bench import Scenario, Stand, at_rest
from adaptdrive_sim.campaign.drawn import Deployed, DrawnRun, deploy
from adaptdrive_sim.campaign.life import Life
from adaptdrive_sim.experiments.examples import example_tables
from adaptdrive_sim.plants.motor import MotorParameters

QUIET: dict[str, Any] = {"line_voltage": 1.0, "frequency_Hz": 60.0} | dict.fromkeys(
    ("voltage_V", "power_W", "scale_S", "spike_share"), 0.0
)


@dataclass(frozen=True, slots=True)
class Case:
    """One comparison.

    Attributes:
        name: Letter, with the load in front where it is no motor.
        title: What happens.
        stand: The run of a seed.
        begin_s: Begin of the part that is judged.
        end_s: Its end.
        unit: 100 % of the figures, in the unit of the output.
    """

    name: str
    title: str
    stand: Callable[[int], DrawnRun]
    begin_s: float
    end_s: float
    unit: float


def motor(
    seed: int,
    inertias: tuple[float, ...] = (1.0,),
    *,
    swing: tuple[float, float, float] = (3.0, 3.2, 120.0),
    sigma: float = 0.002,
    output_V: float = 0.0,
    filter_s: float = 10.0,
    at_s: float = 600.0,
    **life: Any,
) -> Stand:
    """A run of a motor.

    Args:
        seed: Of the noise.
        inertias: In disks, before and after the change.
        swing: Low and high set-point, and the period in s.
        sigma: Noise of each sample, as a share of the step.
        output_V: Resolution of the tachometer.
        filter_s: Time constant of its filter.
        at_s: When the inertia changes.
        life: Fields of `Life`.
    """
    low, high, period_s = swing
    ramps_s = (0.0,) * len(life.get("torques_V", ()))
    scenario = Scenario(
        seed=seed,
        duration_s=1320.0,
        inertias=inertias,
        change_times_s=(at_s,) * (len(inertias) - 1),
        gain=1.0,
        filter=filter_s / 10.0,
        reference=Waveform(Shape.SQUARE, low, high, period_s),
        sigma=sigma * (high - low),
        spike_sigma=0.0,
        output_delay_ticks=0,
        output_quantum=output_V,
        life=Life(torque_ramps_s=ramps_s, inertia_ramps_s=(0.0,) * (len(inertias) - 1), **life),
        **QUIET,
    )
    return Stand(scenario)


ENCODER_V = 0.1 * MotorParameters().tachometer_Vs
"""Resolution of 0.1 rad/s."""


@cache
def _encoder() -> Deployed:
    """The controller of a motor with an encoder, as somebody would guess its second lag."""
    tables = example_tables("motor.toml")
    tables["load"]["model"]["tau_filter_s"] = 0.2
    return at_rest(deploy("motor.toml", tables))


def encoder(seed: int) -> Stand:
    """A motor with an encoder and friction, of a second lag of 0.01 to 0.5 s; inertia doubled."""
    lag_s = 0.5 * 50.0 ** -float(np.random.default_rng([seed, 9]).random())
    stand = motor(seed, (1.0, 2.0), output_V=ENCODER_V, filter_s=lag_s, coulomb_V=10.0, drag_V=10.0)
    stand.own = _encoder()
    return stand


def _torque(at_s: float) -> dict[str, Any]:
    return {"torque_times_s": (at_s,), "torques_V": (40.0,)}


def _case(
    name: str,
    title: str,
    judged_s: tuple[float, float] = (1200.0, 1320.0),
    unit: float = 0.2,
    *,
    stand: Callable[..., DrawnRun] = motor,
    **values: Any,
) -> Case:
    return Case(name, title, partial(stand, **values), *judged_s, unit)


HEAVIER = (1.0, 3.0)
EDGE = (2.6, 4.3, 240.0)
REST = (3.1999, 3.2, 1320.0)

LAST = (1080.0, 1320.0)
TORQUE = (1075.0, 1137.0)

MOTORS = (
    _case("A", "one disk"),
    _case("B", "one disk, then three", inertias=HEAVIER),
    _case("C", "as B, noise 2 %", inertias=HEAVIER, sigma=0.02),
    _case("D", "two disks, then half a one", inertias=(2.0, 0.5)),
    _case("E", "one disk, steps to the limit of V_c", LAST, 1.7, swing=EDGE),
    _case("F", "as E, then three disks", LAST, 1.7, swing=EDGE, inertias=HEAVIER),
    _case("G", "torque, one disk", (655.0, 755.0), 0.44, swing=REST, sigma=2.0, **_torque(660.0)),
    _case("H", "torque, three disks", TORQUE, inertias=HEAVIER, at_s=300.0, **_torque(1080.0)),
    _case("I", "as B, tachometer in steps of 20 mV", inertias=HEAVIER, output_V=0.02),
    _case("J", "torque while the set-point moves", TORQUE, **_torque(1080.0)),
    _case("K", "as J, noise 2 %", TORQUE, sigma=0.02, **_torque(1080.0)),
    _case("L", "encoder, inertia doubled", stand=encoder),
)

CASES = {case.name: case for case in MOTORS}
