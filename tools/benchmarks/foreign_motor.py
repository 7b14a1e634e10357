"""The twin of a foreign motor: friction that no model has, a 12-bit tachometer, a wrong model.

    python -m tools.benchmarks.foreign_motor SEED [--runs N]

prints how many runs hold each claim, and a line for each run that does not hold all of them. The
motor of `tests/peers`, in virtual time: Coulomb, viscous and quadratic friction, by the
midpoint rule. Its line, its capacitor and its time constants are not what the configuration says.
The inertia grows to twice and to three times its value at random times under a square wave.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive.runtime.requests import SetSetpoint, SetWaveform
from adaptdrive_sim.plants.boost import BoostParameters, LineParameters
from adaptdrive_sim.site import OperatedDrive
from adaptdrive_sim.world import NoiseParameters, World
from tests.integration.closed_loop.life import (
    CYCLE_S,
    HIGH,
    LOW,
    STEP,
    Rows,
    Sensed,
    periods,
    started,
    wait,
)
from tools.benchmarks.seeds import over_seeds

QUANTUM_V = 5.0 / 4096.0
NOISE_V = 0.01 * STEP
CONFIGURED = {"gain": 0.011, "tau_motor_s": 11.7, "tau_filter_s": 10.0}
JUDGED_S = 40.0
WITHIN = 0.05
DEVIATIONS = 2.0


@dataclass
class ForeignMotor:
    """Shaft with friction, and a filtered tachometer; a load of a simulated drive."""

    resistance_Ohm: float = 5.75
    constant_Vs: float = 0.3
    viscous_Nms: float = 0.005
    coulomb_Nm: float = 0.20
    quadratic_Nms2: float = 4.0e-6
    inertia_kgm2: float = 0.226
    tachometer_Vs: float = 0.020533
    filter_s: float = 10.0
    speed_rad_s: float = 0.0
    output: float = 0.0

    @property
    def emf_V(self) -> float:
        """Back-EMF."""
        return self.constant_Vs * self.speed_rad_s

    def drive(self, source_V: float, source_Ohm: float, duration_s: float) -> float:
        """Advance under a source that conducts in one direction; return the mean current."""
        before, series_Ohm = self.speed_rad_s, source_Ohm + self.resistance_Ohm
        self._advance(source_V, series_Ohm, duration_s)
        emf_V = 0.5 * self.constant_Vs * (before + self.speed_rad_s)
        return max(0.0, source_V - emf_V) / series_Ohm

    def coast(self, duration_s: float) -> None:
        """Advance without any current."""
        self._advance(0.0, math.inf, duration_s)

    def settle(self, source_V: float, source_Ohm: float) -> None:
        """Put the motor at rest under a source, by bisection."""
        low, high = 0.0, source_V / self.constant_Vs
        for _ in range(60):
            middle = 0.5 * (low + high)
            needed_V = self._source(middle, source_Ohm)
            low, high = (middle, high) if needed_V < source_V else (low, middle)
        self.speed_rad_s, self.output = low, self.tachometer_Vs * low

    def source_for(self, output: float, source_Ohm: float) -> float:
        """Return the source voltage that holds a tachometer voltage."""
        return self._source(output / self.tachometer_Vs, source_Ohm)

    def model(self, ratio: float, source_Ohm: float) -> dict[str, float]:
        """Return gain and time constants, linear about the present speed."""
        series_Ohm = source_Ohm + self.resistance_Ohm
        slope = self.viscous_Nms + 2.0 * self.quadratic_Nms2 * self.speed_rad_s
        damping = slope + self.constant_Vs**2 / series_Ohm
        gain = self.tachometer_Vs * ratio * self.constant_Vs / series_Ohm / damping
        lag_s = self.inertia_kgm2 / damping
        return {"gain": gain, "tau_motor_s": lag_s, "tau_filter_s": self.filter_s}

    def state(self) -> dict[str, float]:
        """Return speed and inertia."""
        return {"speed_rad_s": self.speed_rad_s, "inertia_kgm2": self.inertia_kgm2}

    def _source(self, speed: float, source_Ohm: float) -> float:
        current_A = self._friction(speed) / self.constant_Vs
        return self.constant_Vs * speed + (source_Ohm + self.resistance_Ohm) * current_A

    def _friction(self, speed: float) -> float:
        steady = self.viscous_Nms * speed + self.quadratic_Nms2 * speed * speed
        return steady + self.coulomb_Nm * math.tanh(speed)

    def _rates(
        self, speed: float, output: float, source_V: float, series_Ohm: float
    ) -> tuple[float, float]:
        current_A = max(0.0, source_V - self.constant_Vs * speed) / series_Ohm
        torque_Nm = self.constant_Vs * current_A - self._friction(speed)
        lag_V = self.tachometer_Vs * speed - output
        return torque_Nm / self.inertia_kgm2, lag_V / self.filter_s

    def _advance(self, source_V: float, series_Ohm: float, duration_s: float) -> None:
        half_s, speed, output = 0.5 * duration_s, self.speed_rad_s, self.output
        up, out = self._rates(speed, output, source_V, series_Ohm)
        up, out = self._rates(speed + half_s * up, output + half_s * out, source_V, series_Ohm)
        self.speed_rad_s = max(0.0, speed + duration_s * up)
        self.output = output + duration_s * out


@dataclass(frozen=True)
class Drawn:
    """A foreign motor drawn at random.

    Attributes:
        seed: Of everything.
        changes_s: Times after the start of the wave at which the inertia is 2 and 3 times its own.
        model: `[load.model]` of the daemon, which is wrong.
        end_s: End of the wave.
    """

    seed: int
    changes_s: tuple[float, float]
    model: dict[str, float]
    end_s: float


@dataclass
class Judged:
    """What happened after the changes of one run.

    Attributes:
        known: For each change, whether every shown parameter was right 40 s later.
        worst: For each change, the parameter with the largest error then, one that is not right
            first: name, relative error, error in shown deviations.
        in_force: For each change, whether adaptive was in force again one cycle later.
        fell_back: Whether it left force after that, until the next change.
        reasons: Reasons shown at 40 s, and where it fell back.
    """

    known: list[bool] = field(default_factory=list)
    worst: list[tuple[str, float, float]] = field(default_factory=list)
    in_force: list[bool] = field(default_factory=list)
    fell_back: list[bool] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)


def draw(seed: int) -> Drawn:
    """Draw the moments of the changes, and a wrong nominal model whose bounds hold the load."""
    random = np.random.default_rng([seed, 12])
    first_s = 2.0 * CYCLE_S + random.uniform(0.0, CYCLE_S)
    second_s = first_s + 1.5 * CYCLE_S + random.uniform(0.0, CYCLE_S)
    factors = {"gain": (0.8, 1.25), "tau_motor_s": (0.7, 1.6), "tau_filter_s": (0.8, 1.4)}
    model = {name: CONFIGURED[name] * random.uniform(*bounds) for name, bounds in factors.items()}
    return Drawn(seed, (first_s, second_s), model, second_s + 1.5 * CYCLE_S)


def run(drawn: Drawn, changes: dict[str, dict[str, Any]] | None = None) -> tuple[Rows, Judged]:
    """Let the daemon's controller hold the motor through both changes, and judge it."""
    motor = ForeignMotor()
    world = _world(motor, drawn.seed)
    drive = started("motor", world, Mode.ADAPTIVE, {"load.model": drawn.model} | (changes or {}))
    drive.carry_out(SetSetpoint(LOW))
    wait(drive, 20.0)
    drive.carry_out(SetWaveform(Waveform(Shape.SQUARE, LOW, HIGH, CYCLE_S)))
    rows = _follow(drive, motor, drawn)
    assert drive.machine.trip is None, drive.machine.trip
    return rows, _judge(rows, drawn)


def _world(motor: ForeignMotor, seed: int) -> World:
    world = Sensed(
        motor,  # type: ignore[arg-type]  # another plant than the simulator's own
        line=LineParameters(frequency_Hz=59.94, voltage_V=119.3),
        boost=BoostParameters(capacitance_F=1.05e-3),
        noise=NoiseParameters(sigma=NOISE_V),
        seed=seed,
    )
    world.quantum = QUANTUM_V
    world.settle(world.boost_voltage_for(LOW))
    return world


def _follow(drive: OperatedDrive, motor: ForeignMotor, drawn: Drawn) -> Rows:
    rows, began_s, own_kgm2 = Rows(), drive.time_s, motor.inertia_kgm2
    for _ in periods(drive, drawn.end_s):
        rows.append(drive, began_s)
        size = 1 + sum(drive.time_s - began_s >= change_s for change_s in drawn.changes_s)
        motor.inertia_kgm2 = size * own_kgm2
    return rows


def truth(size: int) -> dict[str, float]:
    """Return what is to be shown, by name: linear about the middle of the wave."""
    motor = ForeignMotor(speed_rad_s=0.5 * (LOW + HIGH) / ForeignMotor.tachometer_Vs)
    motor.inertia_kgm2 *= size
    found = motor.model(0.25, 1.0)
    lag_s, filter_s = found["tau_motor_s"], found["tau_filter_s"]
    return {
        "gain": found["gain"],
        "tau_sum_s": lag_s + filter_s,
        "tau_product_s2": lag_s * filter_s,
    }


def _judge(rows: Rows, drawn: Drawn) -> Judged:
    judged, times = Judged(), np.array(rows.time_s)
    ends_s = (drawn.changes_s[1], drawn.end_s)
    for change_s, end_s, size in zip(drawn.changes_s, ends_s, (2, 3), strict=True):
        at = int(np.searchsorted(times, change_s + JUDGED_S))
        errors = _errors(rows.estimates[at], truth(size))
        judged.known.append(all(_is_right(*error) for error in errors.values()))
        worst = max(errors, key=lambda name: _severity(*errors[name]))
        judged.worst.append((worst, *errors[worst]))
        later = slice(*np.searchsorted(times, [change_s + CYCLE_S, end_s]))
        judged.in_force.append(rows.adaptive[later.start])
        judged.fell_back.append(not all(rows.adaptive[later]))
        pairs = zip(rows.adaptive[later], rows.reasons[later], strict=True)
        fell = sorted({why for adaptive, why in pairs if not adaptive})
        judged.reasons.append("; ".join([rows.reasons[at], *fell]))
    return judged


def _errors(
    shown: dict[str, tuple[float, float]], true: dict[str, float]
) -> dict[str, tuple[float, float]]:
    """Return the error of each parameter: relative, and in shown deviations."""
    found = {}
    for name, value in true.items():
        error = abs(shown[name][0] - value)
        found[name] = (error / value, error / shown[name][1])
    return found


def _is_right(relative: float, deviations: float) -> bool:
    return relative <= WITHIN or deviations <= DEVIATIONS


def _severity(relative: float, deviations: float) -> tuple[bool, float]:
    """Return how bad an error is: one that is not right first, then the largest."""
    return not _is_right(relative, deviations), relative


def main() -> None:
    """Print the counts."""
    found: list[Judged] = []
    for seed, judged in over_seeds(_judged, __doc__, runs=200):
        found.append(judged)
        if not _holds(judged):
            sys.stdout.write(f"{seed}: {judged}\n")
            sys.stdout.flush()
    sys.stdout.write(_summary(found))


def _judged(seed: int) -> Judged:
    return run(draw(seed))[1]


def _holds(judged: Judged) -> bool:
    return all(judged.known) and all(judged.in_force) and not any(judged.fell_back)


def _summary(found: list[Judged]) -> str:
    known = sum(all(one.known) for one in found)
    changes = [worst for one in found for worst in one.worst]
    close = sum(relative <= WITHIN for _, relative, _ in changes)
    in_force = sum(all(one.in_force) for one in found)
    fell_back = sum(any(one.fell_back) for one in found)
    return (
        f"{len(found)} runs, {len(changes)} changes\n"
        f"right or within two shown deviations {JUDGED_S:g} s after both changes: {known} runs\n"
        f"of the changes, every parameter within {100 * WITHIN:g} % then: {close}\n"
        f"adaptive in force one cycle after both changes: {in_force} runs\n"
        f"adaptive not in force at some time after that: {fell_back} runs\n"
    )


if __name__ == "__main__":
    main()
