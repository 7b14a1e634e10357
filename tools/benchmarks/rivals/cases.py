"""The cases: a plant, what happens to it, and the part of the run that is judged."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.loads.load import Load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive_sim.campaign.batteries import ideal_current
from adaptdrive_sim.campaign.drawn import Deployed, Drawn, DrawnRun, Row, at_rest, deploy
from adaptdrive_sim.campaign.stands import BathScenario, BathStand, Life, Scenario, Stand
from adaptdrive_sim.course import NO_TRIPS, Course
from adaptdrive_sim.parameters import example_tables
from adaptdrive_sim.plants.bath import BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.boost import CouplingParameters
from adaptdrive_sim.plants.motor import MotorParameters
from adaptdrive_sim.world import World

Array = NDArray[np.float64]

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


class LaggingBath(BathStand):
    """A bath of 140 s whose sensor lags by 20 s, as a well-known teaching kit has it.

    What is asked for is what a bath without that lag would do.
    """

    lags_s = (140.0, 20.0)

    def __init__(self, scenario: BathScenario) -> None:
        super().__init__(scenario)
        self.own = _kit()

    def _parameters(self, k: int) -> BathParameters:
        return replace(super()._parameters(k), sensor_s=self.lags_s[1])

    def true_load(self, k: int) -> Load:
        """The model of bath and sensor."""
        one = super().true_load(k)
        gain, lag_s = one.numerator[1] / one.denominator[1], 1.0 / one.denominator[1]
        both = motor_load(gain, lag_s, self.lags_s[1])
        return replace(one, numerator=both.numerator, denominator=both.denominator)

    def true_loads(self) -> list[Load]:
        """Return what is asked for."""
        return [super(LaggingBath, self).true_load(k) for k in range(self.times_s.size)]


def bath(
    seed: int,
    volumes: tuple[float, ...] = (1.0,),
    inflows: tuple[float, ...] = (1.0,),
    *,
    tau_s: float = 200.0,
    output_K: float = 0.0,
    high_K: float = 12.0,
    kind: type[BathStand] = BathStand,
) -> BathStand:
    """A run of a bath.

    Args:
        seed: Of the noise.
        volumes: Of the water over that of the model, before and after the change.
        inflows: Likewise.
        tau_s: Time constant of the true bath at the start.
        output_K: Resolution of the sensor.
        high_K: Larger set-point; the other is 10 K.
        kind: The bath.
    """
    first_gal = BathParameters().volume_gal * tau_s / 200.0
    scenario = BathScenario(
        seed=seed,
        duration_s=7200.0,
        volumes_gal=tuple(first_gal * volume for volume in volumes),
        fill_times_s=(3600.0,) * (len(volumes) - 1),
        fill_s=60.0,
        inflows=inflows,
        inflow_times_s=(5700.0,) * (len(inflows) - 1),
        drift_K_per_h=0.0,
        turn_s=3600.0,
        resistance=1.0,
        ageing_per_h=0.0,
        reference=Waveform(Shape.SQUARE, 10.0, high_K, 1800.0),
        constant=False,
        sigma=0.02,
        spike_sigma=0.0,
        output_quantum=output_K,
        offset_K=0.0,
        output_delay_ticks=0,
        **QUIET,
    )
    return kind(scenario)


@cache
def _kit() -> Deployed:
    """The controller of the kit, with the one lag that fits it best."""
    tables = example_tables("bath.toml")
    tables["load"]["pole"] = 0.65
    tables["load"]["model"]["tau_s"] = 160.0
    return deploy("bath.toml", tables)


def _bath_case(name: str, title: str, begin_s: float = 5400.0, **values: Any) -> Case:
    unit = values.get("high_K", 12.0) - 10.0
    return _case(name, title, (begin_s, begin_s + 1800.0), unit, stand=bath, **values)


LARGER = (1.0, 2.5)
KIT: dict[str, Any] = {"kind": LaggingBath, "tau_s": 140.0, "output_K": 0.32, "high_K": 14.0}

BATHS = (
    _bath_case("bath A", "as the model"),
    _bath_case("bath B", "0.6, then 1.5 gallons", volumes=LARGER),
    _bath_case("bath G", "a third more cold water at a steady set-point", inflows=(1.0, 1.3)),
    _bath_case("bath I", "as B, sensor in steps of 0.32 K", volumes=LARGER, output_K=0.32),
    _bath_case("bath M", "two lags, sensor in steps of 0.32 K", 1800.0, **KIT),
    _bath_case("bath N", "as M, then twice the water", volumes=(1.0, 2.0), **KIT),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Charge(Drawn):
    """A charge with a current that changes in steps.

    Attributes:
        series: Series resistance over that of the model, before and after the change.
        shorted: Cells that are shorted from the change on.
        real: Whether the EMF and the relaxation are those of real cells.
    """

    series: tuple[float, ...]
    shorted: int
    real: bool


def charge(
    seed: int, series: tuple[float, ...] = (1.0,), *, shorted: int = 0, real: bool = False
) -> ChargingStand:
    """A run of a battery: see `Charge`."""
    scenario = Charge(
        seed=seed,
        duration_s=1200.0,
        reference=Waveform(Shape.SQUARE, 6.0, 8.0, 120.0),
        sigma=0.01,
        spike_sigma=0.0,
        output_delay_ticks=0,
        output_quantum=0.0,
        series=series,
        shorted=shorted,
        real=real,
        **QUIET,
    )
    return ChargingStand(scenario)


def open_circuit_V(charge: float) -> float:
    """Voltage of an LG M50 cell at rest (Chen et al., J. Electrochem. Soc. 167, 2020, 080534)."""
    p, n = 0.9077 - 0.6416 * charge, 0.0279 + 0.8735 * charge
    positive = 4.4875 - 0.8090 * p - 0.0428 * math.tanh(18.5138 * (p - 0.5542))
    positive += 17.5842 * math.tanh(15.9308 * (p - 0.3120))
    positive -= 17.7326 * math.tanh(15.7890 * (p - 0.3117))
    negative = 0.2482 + 1.9793 * math.exp(-39.3631 * n)
    negative -= 0.0909 * math.tanh(29.8538 * (n - 0.1234))
    negative -= 0.04478 * math.tanh(14.9159 * (n - 0.2769))
    return positive - negative - 0.0205 * math.tanh(30.4444 * (n - 0.6103))


REAL_V = tuple(open_circuit_V(i / 200.0) for i in range(201))


@cache
def _charger() -> Deployed:
    """The controller of the charger, before the voltage limit."""
    own = deploy("battery.toml")
    return replace(own, load=replace(own.load, charging=None))


class ChargingStand(DrawnRun):
    """The course of a charge."""

    size_name, largest_movement = "series", 2.0

    def __init__(self, scenario: Charge) -> None:
        super().__init__(_charger(), scenario, scenario.reference.high)
        self.scenario = scenario
        later = self.times_s >= 600.0
        self.sizes = np.where(later, scenario.series[-1], scenario.series[0])
        self.plan = Course(
            references=scenario.references_at(self.times_s),
            sizes=self.sizes,
            disturbances=scenario.disturbances(self.ticks + 1),
            burdens=np.where(later, float(scenario.shorted), 0.0),
        )
        changes = len(scenario.series) > 1 or scenario.shorted > 0
        self.change_times_s = (600.0,) if changes else ()

    def columns(self) -> Row:
        """Nothing is drawn."""
        return {}

    def course(self, mode: Mode) -> Course:
        """Return what happens in the run."""
        return replace(super().course(mode), trips=NO_TRIPS)

    def _battery(self, series: float) -> Battery:
        nominal = BatteryParameters()
        parameters = replace(nominal, charge=0.1, series_Ohm=nominal.series_Ohm * series)
        if not self.scenario.real:
            return Battery(parameters)
        slow = replace(parameters, relaxation_2_Ohm=0.2, relaxation_2_s=400.0)
        return Battery(slow, REAL_V)

    def world(self) -> World:
        """Return the plant as it is at the start."""
        return World(self._battery(self.scenario.series[0]))

    def true_load(self, k: int) -> Load:
        """Return the model of the true battery."""
        stage = CouplingParameters()
        values = self._battery(float(self.sizes[k])).model(stage.ratio, stage.droop_Ohm)
        numerator, denominator = self.own.load.realise(list(values.values()))
        own = self.own.load
        return replace(own, numerator=tuple(numerator), denominator=tuple(denominator))

    @cached_property
    def ideal(self) -> Array:
        """Return what is asked for."""
        return ideal_current(self.plan.references, self.own.pole)


def _charge_case(name: str, title: str, begin_s: float = 1080.0, **values: Any) -> Case:
    return _case(name, title, (begin_s, begin_s + 120.0), 2.0, stand=charge, **values)


BATTERIES = (
    _charge_case("battery A", "as the model"),
    _charge_case("battery B", "twice the series resistance", series=(1.0, 2.0)),
    _charge_case("battery M", "real cells", 480.0, real=True),
    _charge_case("battery N", "as M, one of 20 cells shorted", 600.0, real=True, shorted=1),
)

CASES = {case.name: case for case in (*MOTORS, *BATHS, *BATTERIES)}
