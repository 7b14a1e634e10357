"""The experiment on a plant of the user, in virtual time."""

from __future__ import annotations

import math
from pathlib import Path

from adaptdrive.analysis.closed_loop import Plant, advanced, at_own_step
from adaptdrive.app.examine import examine_text
from adaptdrive.app.settings import tick_s
from adaptdrive.commissioning.course import Samples
from adaptdrive.commissioning.evaluation import judge_sensor
from adaptdrive.commissioning.experiment import LoadExperiment
from adaptdrive.commissioning.report import Commissioned, judged
from adaptdrive.commissioning.target import build_target
from adaptdrive.config.file import read_text
from adaptdrive.config.root import Configuration
from adaptdrive.util.errors import CommissionError

_SAMPLE_S = 0.1
"""Time between two samples, as between two messages of the daemon."""

_LAG_S = 0.075
"""Lag of the boost voltage behind V_c."""

_WATCHED_S = 5.0
_LONGEST_S = 30 * 86400.0


class _Rig:
    """A plant behind a boost stage, sampled as telemetry is."""

    def __init__(self, plant: Plant, configuration: Configuration) -> None:
        self._plant = at_own_step(plant)
        self._step_s = tick_s(configuration) * configuration.bus.ticks_per_reading
        self._count = max(1, round(_SAMPLE_S / self._step_s))
        self._share = -math.expm1(-self._step_s / _LAG_S)
        self._taken = 0
        self.time_s = 0.0
        self.boost_V = max(configuration.drive.limits.boost_reference_min_V, 0.0)

    def sample(self, wanted_V: float) -> tuple[float, float, float]:
        """Advance by a sample under V_c; return its time, boost voltage and output."""
        output = 0.0
        for _ in range(self._count):
            before_V = self.boost_V
            self.boost_V += self._share * (wanted_V - before_V)
            mean_V = 0.5 * (before_V + self.boost_V)
            output, _ = advanced(self._plant, mean_V, self._step_s, self._taken)
            self._taken += 1
        self.time_s = self._taken * self._step_s
        return self.time_s, self.boost_V, output


def commission_plant(
    path: Path, plant: Plant, move_share: float, patience_s: float | None
) -> Commissioned:
    """Run the experiment on a plant and evaluate it.

    Args:
        path: Configuration with the limits of the drive and of the output.
        plant: The plant.
        move_share: Movement of the output as a share of the set-point range.
        patience_s: Shortest wait for a response; that of the kind of load when None.

    Raises:
        AdaptdriveError: The experiment cannot continue, or does not show the load.
    """
    text = read_text(path)
    configuration = examine_text(text, path)
    target = build_target(configuration, move_share, patience_s)
    rig, standby = _Rig(plant, configuration), Samples()
    while rig.time_s < _WATCHED_S:
        standby.append(*rig.sample(target.low_V))
    sensor = judge_sensor(standby, configuration, target.move)
    experiment = LoadExperiment(target)
    while not experiment.done:
        experiment.take(*rig.sample(experiment.course.voltage_V))
        if rig.time_s > _LONGEST_S:
            raise CommissionError("the experiment does not end within 30 days")
    return judged(sensor, experiment, configuration, text, path)
