"""Records of random loads, simulated by scipy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete

from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.load import Charging, Load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.identification.excerpt import Excerpt
from tests.unit.control.systems import System

Array = NDArray[np.float64]
Random = np.random.Generator


@dataclass(frozen=True, slots=True)
class Plant:
    """A load with known parameters, and a `Load` of its structure with wrong ones."""

    structure: Load
    truth: Load

    @property
    def parameters(self) -> list[float]:
        return self.truth.physical(list(self.truth.numerator), list(self.truth.denominator))


def decade(random: Random, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def motor(random: Random) -> Plant:
    gain, tau_s, filter_s = 0.011 * decade(random, 0.3, 3.0), decade(random, 1.0, 30.0), 10.0
    truth = motor_load(gain, tau_s, filter_s * decade(random, 0.1, 1.0))
    return Plant(motor_load(1.0, 1.0, 1.0), truth)


def bath(random: Random) -> Plant:
    resistance = 0.021 * decade(random, 0.2, 5.0)
    truth = bath_load(resistance, decade(random, 3.0, 30.0), 0.25, 1.0, 7.87)
    return Plant(bath_load(1.0, 1.0, 0.25, 1.0, 7.87), truth)


def battery(random: Random) -> Plant:
    series_Ohm, relaxation_Ohm = 1.0 + decade(random, 0.1, 1.0), decade(random, 0.2, 2.0)
    truth = battery_load(0.25, series_Ohm, relaxation_Ohm, decade(random, 5.0, 30.0))
    return Plant(battery_load(0.25, 9.0, 9.0, 9.0), truth)


KINDS: dict[str, Callable[[Random], Plant]] = {"motor": motor, "bath": bath, "battery": battery}


def random_voltage(random: Random, count: int, longest: int = 60) -> Array:
    """Steps between 200 and 400 V at random times."""
    levels = random.choice([220.0, 300.0, 380.0], size=count)
    lengths = random.integers(5, longest, size=count)
    return np.repeat(levels, lengths)[:count]


def open_loop(
    load: Load, voltage_V: Array, period_s: float, delay: int = 0, offset: float = 0.0
) -> Array:
    """Output without noise; each voltage acts from half a period before its sample to half after.

    The load rests at 300 V before.
    """
    inputs = load.input_gain * voltage_V**load.input_exponent + offset
    rest = load.input_gain * 300.0**load.input_exponent + offset
    late = np.concatenate((np.full(delay, rest), inputs))[: len(inputs)]
    a, b, c, d = _half_steps(load, period_s)
    state = np.linalg.solve(np.eye(len(a)) - a, b * rest)
    outputs = []
    for value in late.tolist():
        state = a @ state + b * value
        outputs.append(float(c @ state) + d * value)
        state = a @ state + b * value
    return np.array(outputs)


def _half_steps(load: Load, period_s: float) -> tuple[Array, Array, Array, float]:
    system = System(list(load.numerator), list(load.denominator))
    a, b, c, d, _ = cont2discrete(system.state_space(), 0.5 * period_s)
    return a, b[:, 0], c[0], float(d[0, 0])


def closed_loop(
    load: Load, setpoints: Array, noise: Array, period_s: float, gains: tuple[float, float]
) -> Excerpt:
    """A PI controller with a period's delay holds the noisy output of a load of one input."""
    a, b, c, _ = _half_steps(load, period_s)
    state = np.linalg.solve(np.eye(len(a)) - a, b * 300.0)
    voltage_V, total = 300.0, 0.0
    volts, outputs = [], []
    for setpoint, disturbance in zip(setpoints.tolist(), noise.tolist(), strict=True):
        state = a @ state + b * voltage_V
        output = float(c @ state) + disturbance
        volts.append(voltage_V)
        outputs.append(output)
        state = a @ state + b * voltage_V
        total += gains[1] * (setpoint - output)
        voltage_V = 300.0 + gains[0] * (setpoint - output) + total
    return Excerpt(np.array(volts), np.array(outputs), period_s)


def charging() -> Charging:
    return Charging(0.25, 1.0, 0.2, 82.0, 1.0)
