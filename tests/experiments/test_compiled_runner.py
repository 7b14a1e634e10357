"""A case on compiled code against the same case, interpreted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adaptdrive_sim.experiments.bath import BATH
from adaptdrive_sim.experiments.case import Design, Disturbance, Variant
from adaptdrive_sim.experiments.experiment import Experiment, LoadChange
from adaptdrive_sim.experiments.motor import DROPPED
from adaptdrive_sim.experiments.runner import run_case
from tests.experiments.cases import make_case
from tests.experiments.compiled_case import run_case_compiled

SHORT_BATH = replace(BATH, duration_s=2400.0, changes=(LoadChange(1000.0, 2.5, over_s=300.0),))
SHORT_MOTOR = replace(DROPPED, duration_s=240.0, changes=(LoadChange(150.0, 2.0),))
SPIKES = Disturbance(0.002, 0.02, 0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("experiment", "variant", "design", "disturbance"),
    [
        (SHORT_BATH, "fixed", "paper", None),
        (SHORT_BATH, "adaptive", "paper", None),
        (SHORT_MOTOR, "adaptive", "exact", SPIKES),
    ],
)
def test_a_compiled_case_is_the_interpreted_one(
    experiment: Experiment, variant: Variant, design: Design, disturbance: Disturbance | None
) -> None:
    case = make_case(experiment, variant, design, disturbance, seed=3)
    expected, found = run_case(case), run_case_compiled(case)
    assert found.time_s == expected.time_s
    assert found.reference == expected.reference
    assert found.size == expected.size
    assert found.adaptive == expected.adaptive
    assert found.accepted == expected.accepted
    for name in ("output", "measured", "boost_reference_V", "applied_V", "innovation"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-6, atol=1e-9, err_msg=name
        )
    for name in experiment.nominal().names:
        np.testing.assert_allclose(found.estimates[name], expected.estimates[name], rtol=1e-6)
