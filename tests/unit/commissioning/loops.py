"""The proposed loop around the true load, by the exact model of both."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from adaptdrive.analysis.replay import reconfigured
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.commissioning.proposal import propose
from adaptdrive.config.root import Configuration
from adaptdrive.control.design.pole_placement import Plant, discrete_model
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive_sim.parameters import EXAMPLES
from tests.unit.commissioning.draws import Draw

_STEPS = 400
_FILE = EXAMPLES / "drawn.toml"


@dataclass(frozen=True, slots=True)
class Loop:
    """A proposed loop around the true load.

    Attributes:
        pole: Size of its slowest pole; below 1 the loop is stable.
        error: Largest distance of its response from the predicted one, over the step.
    """

    pole: float
    error: float


def loop_around(draw: Draw, identified: IdentifiedLoad) -> Loop:
    """Close the proposed loop around the load of a draw."""
    proposed = propose(identified, draw.text, _FILE)
    options = [f"{key}={value!r}" for key, value in proposed.values.items()]
    true = [f"load.model.{key}={float(value)!r}" for key, value in draw.model.items()]
    a, b = _model(proposed.configuration, 0.0)
    configuration = reconfigured(draw.text, _FILE, [*options, *true])
    true_a, true_b = _model(configuration, draw.delay_steps * draw.step_s)
    plant = Plant(a, b)
    gains = plant.gains(plant.asked(proposed.configuration.load.pole))
    taps = len(gains) - plant.order - 1
    r, s = [1.0, *gains[:taps]], gains[taps:]
    closed = [
        np.polyadd(np.convolve(one_a, r)[::-1], np.convolve(one_b, s)[::-1])[::-1]
        for one_a, one_b in ((a, b), (true_a, true_b))
    ]
    predicted, real = (
        lfilter(sum(s) * np.array(one), poles, np.ones(_STEPS))
        for one, poles in zip((b, true_b), closed, strict=True)
    )
    return Loop(
        pole=float(np.abs(np.roots(closed[1])).max()), error=float(np.abs(real - predicted).max())
    )


def _model(configuration: Configuration, more_s: float) -> tuple[list[float], list[float]]:
    """The discrete model of a configured load with an additional dead time."""
    load, settings = build_load(configuration), controller_settings(configuration)
    numerator, denominator = list(load.numerator), list(load.denominator)
    late = replace(load, delay_s=load.delay_s + more_s)
    return discrete_model(settings, late, numerator, denominator, configuration.load.period_s)
