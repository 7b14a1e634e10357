"""The life of a drive: torque, noise and idle hours, on seeds of your own.

    python -m tools.benchmarks.disturbances SEED [--runs N]

prints one line for each scenario: median and worst over the runs.
"""

from __future__ import annotations

import sys
from functools import partial

import numpy as np

from adaptdrive.control.signals import Mode
from tests.integration.closed_loop.life import (
    STEP,
    Event,
    Motion,
    random_torque,
    swinging_torque,
    torque_steps,
)
from tools.benchmarks.seeds import over_seeds

LEARNT_S = 240.0
KNOWN = {"load.model": {"tau_motor_s": 35.1}}
SCENARIOS = ("torque steps", "torque steps, noise 2 %", "sinusoidal torque", "random torque")


def main() -> None:
    """Print the table."""
    say = sys.stdout.write
    say("| scenario | adaptive, median (worst) | in force, least | load known, median (worst) |\n")
    say("|---|---|---|---|\n")
    for scenario in SCENARIOS:
        found = np.array([row for _, row in over_seeds(partial(_run, scenario), __doc__)])
        (adaptive, in_force, known) = found.T
        say(
            f"| {scenario} | {np.median(adaptive):.3f} ({adaptive.max():.3f}) "
            f"| {100.0 * in_force.min():.0f} % | {np.median(known):.3f} ({known.max():.3f}) |\n"
        )
        sys.stdout.flush()


def _run(scenario: str, seed: int) -> tuple[float, float, float]:
    """Model error and time in force of the adaptive controller, and what knowing the load gives."""
    noise = 0.02 if scenario.endswith("2 %") else 0.002
    motion, event = Motion(noise=noise * STEP, seed=seed), _event(scenario, seed)
    rows = motion.run(Mode.ADAPTIVE, event)
    known = motion.run(Mode.FIXED, event, KNOWN)
    return (
        rows.model_error(3, LEARNT_S),
        rows.in_force(LEARNT_S),
        known.model_error(3, LEARNT_S),
    )


def _event(scenario: str, seed: int) -> Event:
    if scenario.startswith("torque"):
        return torque_steps
    return swinging_torque(seed) if scenario.startswith("sin") else random_torque(seed)


if __name__ == "__main__":
    main()
