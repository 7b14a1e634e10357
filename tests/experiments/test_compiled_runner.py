"""A case on compiled code against the same case, interpreted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adaptdrive_sim.experiments.case import Design, Disturbance, Variant, run_case
from adaptdrive_sim.experiments.experiment import Experiment, LoadChange
from adaptdrive_sim.experiments.published import BATH, DROPPED
from tests.experiments.cases import make_case
from tests.support import compiled

SHORT_BATH = replace(BATH, duration_s=2400.0, changes=(LoadChange(1000.0, 2.5, over_s=300.0),))
SHORT_MOTOR = replace(DROPPED, duration_s=240.0, changes=(LoadChange(150.0, 2.0),))
SPIKES = Disturbance(0.002, 0.02, 0.1)


@compiled
@pytest.mark.parametrize(
    ("experiment", "variant", "design", "disturbance"),
    [
        (SHORT_MOTOR, "adaptive", "exact", SPIKES),
        (SHORT_BATH, "fixed", "paper", None),
        (SHORT_BATH, "adaptive", "paper", None),
    ],
)
def test_a_compiled_case_is_the_interpreted_one(
    experiment: Experiment, variant: Variant, design: Design, disturbance: Disturbance | None
) -> None:
    case = make_case(experiment, variant, design, disturbance, seed=3)
    expected, found = run_case(case), run_case(case, compiled=True)
    for name in ("time_s", "reference", "size", "adaptive", "accepted"):
        assert np.array_equal(found[name], expected[name]), name
    for name in ("output", "measured", "boost_reference_V", "applied_V", "innovation"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-6, atol=1e-9, err_msg=name)
    for name in experiment.nominal().names:
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-6)
