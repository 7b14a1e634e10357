"""Motors with an encoder, whose inertia doubles under a square wave, on seeds of your own.

    python -m tools.benchmarks.encoder_motors SEED [--runs N]

An encoder has no tachometer filter: the second lag is that of the electronics, 0.01 to 0.5 s, and
hardly shows in samples of 1 s. The command prints median and worst of

* the share of the time in which adaptive control is in force, from 60 s on;
* the overshoot from one cycle after the change on, and that of fixed control, in % of the step;
* the share of trusted estimates whose gains, on the true load, give a response that differs from
  the one asked for by more than 5 % of the step. From the change to 20 s after the next edge of
  the reference none is counted: no sample shows the new inertia.

Seeds from 610000 and from 710000 on were used for tuning, those from 720000 on for judging only.
"""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.design.pole_placement import Plant, discrete_model
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Mode
from adaptdrive.control.supervision.supervisor import Verdict
from adaptdrive_sim.course import Course, Run
from adaptdrive_sim.parameters import EXAMPLES, example_tables
from adaptdrive_sim.plants.boost import CouplingParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.site import Site
from adaptdrive_sim.wire import Wire
from adaptdrive_sim.world import World
from tools.benchmarks.seeds import over_seeds

Array = NDArray[np.float64]

LOW, HIGH = 145.0, 155.0
"""Square wave in rad/s."""

HALF_S, END_S, FROM_S, SHOWN_S = 60, 1200, 60, 20
RESOLUTION = 0.1
POLE, OFF, SETTLED_PERIODS = 0.7, 0.05, 60
GAIN = 0.011 / 0.020533
"""Of the example's motor, in rad/s for each volt."""


@dataclasses.dataclass(frozen=True)
class Drawn:
    """One drawn motor, and the model that its daemon has of it."""

    seed: int
    motor: MotorParameters
    change_s: int
    noise: float
    settings: ControllerSettings
    load: Load

    @property
    def learnt_s(self) -> int:
        """When samples have shown the change: some time after the next edge."""
        return (self.change_s // HALF_S + 1) * HALF_S + SHOWN_S


def draw(seed: int) -> Drawn:
    """Draw a motor, a wrong model of it, and the moment of the change."""
    random = np.random.default_rng([seed, 44])
    motor = MotorParameters(
        tachometer_Vs=1.0,
        filter_s=float(random.uniform(0.01, 0.5)),
        coulomb_Nm=float(random.uniform(0.0, 0.2)),
    )
    lag_s = float(11.7 * random.uniform(0.7, 1.4))
    model = {
        "gain": float(GAIN * random.uniform(0.8, 1.25)),
        "tau_motor_s": lag_s,
        "tau_filter_s": float(np.exp(random.uniform(np.log(0.05), np.log(1.0)))),
    }
    tables = example_tables("motor.toml")
    tables["load"] |= {"model": model, "reference_max": 220.0, "output_unit": "rad/s"}
    tables["estimator"]["tau_lambda_s"] = round(0.5 * lag_s, 1)
    tables["interlocks"]["output_max"] = 250.0
    configuration = validate_configuration(tables, EXAMPLES / "motor.toml")
    return Drawn(
        seed,
        motor,
        int(random.integers(300, 700)),
        float(np.exp(random.uniform(np.log(0.005), np.log(0.1)))),
        controller_settings(configuration),
        build_load(configuration),
    )


def run(drawn: Drawn, mode: Mode) -> Run:
    """Run a motor; return a row for each second."""
    times = np.arange(END_S)
    references = np.where(times % (2 * HALF_S) < HALF_S, HIGH, LOW)
    references[:5] = LOW
    random = np.random.default_rng([drawn.seed, 45])
    noise = drawn.noise * random.standard_normal(END_S * 120 + 1)
    sizes = np.where(times >= drawn.change_s, 2.0, 1.0)
    wire = Wire([LOW], RESOLUTION, 0.1, 1.0)
    course = Course(references, sizes, noise, mode, POLE)
    world = World(Motor(drawn.motor))
    controller = Controller(drawn.settings, drawn.load)
    found = Site(controller, world, wire).run(course)
    assert found.interlock == 0, (drawn.seed, found.interlock)
    return found


def overshoot(shown: Run, from_s: int) -> float:
    """Return the largest overshoot of a half cycle that begins after a time, in % of the step."""
    worst, output = 0.0, shown["output"]
    for start in range(-(-from_s // HALF_S) * HALF_S, END_S, HALF_S):
        half = output[start : start + HALF_S]
        beyond = half.max() - HIGH if start % (2 * HALF_S) == 0 else LOW - half.min()
        worst = max(worst, 100.0 * beyond / (HIGH - LOW))
    return worst


def response_error(drawn: Drawn, values: Array, size: float) -> float:
    """Return how far the gains for an estimate miss the response on the true load, of the step."""
    settings = drawn.settings
    motor = Motor(drawn.motor)
    motor.resize(size, 0.0)
    coupling = CouplingParameters()
    true = motor.model(coupling.ratio, coupling.droop_Ohm)
    lags = (true["tau_motor_s"], true["tau_filter_s"])
    truth = [true["gain"], sum(lags), lags[0] * lags[1]]
    a, b = discrete_model(settings, drawn.load, *drawn.load.realise(list(values)), 1.0)
    plant = Plant(a, b)
    r, s = plant.place(plant.asked(POLE))
    found = _step(*discrete_model(settings, drawn.load, *drawn.load.realise(truth), 1.0), r, s)
    return float(np.max(np.abs(found - _step(a, b, r, s))))


def _step(a: list[float], b: list[float], r: list[float], s: list[float]) -> Array:
    closed = np.polynomial.polynomial.polyadd(np.convolve(a, r), np.convolve(b, s))
    response: Array = lfilter(sum(s) * np.array(b), closed, np.ones(SETTLED_PERIODS))
    return response


def wrong_share(drawn: Drawn, shown: Run) -> float:
    """Return the share of trusted estimates that are wrong for the loop, in %."""
    wrong, trusted, verdicts = 0, 0, shown["verdict"]
    estimates = np.column_stack([shown[name] for name in drawn.load.names])
    for k in range(FROM_S, END_S):
        if verdicts[k] != Verdict.TRUSTED or drawn.change_s <= k < drawn.learnt_s:
            continue
        trusted += 1
        size = 2.0 if k >= drawn.change_s else 1.0
        wrong += not response_error(drawn, estimates[k], size) <= OFF
    return 100.0 * wrong / max(1, trusted)


def judged(seed: int) -> tuple[float, float, float, float]:
    """Return share in force, overshoot, that of fixed control, and share of wrong estimates, in %.

    Args:
        seed: Of everything.
    """
    drawn = draw(seed)
    adaptive, fixed = run(drawn, Mode.ADAPTIVE), run(drawn, Mode.FIXED)
    from_s = drawn.change_s + 2 * HALF_S
    in_force = 100.0 * float(np.mean(adaptive["adaptive"][FROM_S:]))
    wrong = wrong_share(drawn, adaptive)
    return in_force, overshoot(adaptive, from_s), overshoot(fixed, from_s), wrong


def main() -> None:
    """Print the figures."""
    rows = []
    for seed, row in over_seeds(judged, __doc__):
        sys.stdout.write(f"{seed}: " + "  ".join(f"{one:6.1f}" for one in row) + "\n")
        rows.append(row)
    names = ("in force", "overshoot", "overshoot, fixed", "wrong and trusted")
    for name, column in zip(names, np.array(rows).T, strict=True):
        worst = column.min() if name == "in force" else column.max()
        sys.stdout.write(f"{name}: median {np.median(column):.1f} %, worst {worst:.1f} %\n")


if __name__ == "__main__":
    main()
