"""The metrics, on outputs whose overshoot, settling and convergence are known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import (
    convergence_cycles,
    cycles,
    ideal_output,
    model_errors,
    rms_between,
)
from adaptdrive_sim.experiments.experiment import BATH, MOTOR, Experiment

TIMES = [float(k) for k in range(1320)]


def square_record() -> Run:
    """An output that follows the reference at once."""
    references = [MOTOR.reference.value(time_s) for time_s in TIMES]
    table = np.column_stack((TIMES, references, references))
    return Run(table, ("time_s", "reference", "output"))


@pytest.mark.parametrize(("tick", "excess"), [(130, 0.03), (190, -0.03)])
def test_overshoot_is_the_larger_one_of_both_halves(tick: int, excess: float) -> None:
    record = square_record()
    record["output"][tick] += excess
    record["output"][135] += 0.01
    judged = cycles(MOTOR, "paper", record)
    assert judged[1].overshoot == pytest.approx(0.15)
    assert judged[0].overshoot == judged[2].overshoot == 0.0


@pytest.mark.parametrize(("tick", "settling_s"), [(130, 11.0), (180 + 30, 31.0), (179, None)])
def test_settling_ends_after_the_last_sample_outside_five_percent(
    tick: int, settling_s: float | None
) -> None:
    record = square_record()
    record["output"][125] += 0.0099
    record["output"][tick] += 0.0101
    assert cycles(MOTOR, "paper", record)[1].settling_s == settling_s


@pytest.mark.parametrize(("experiment", "poles"), [(MOTOR, [0.7] * 4), (BATH, [0.8] * 2)])
def test_the_ideal_loop_of_the_papers_design_has_the_papers_closed_form(
    experiment: Experiment, poles: list[float]
) -> None:
    """(27) and (15): all poles where they are wanted, one sample of delay, gain 1."""
    denominator = np.poly(poles)
    periods = round(experiment.duration_s / experiment.period_s)
    low = experiment.reference.low
    reference = np.array(
        [experiment.reference.value(k * experiment.period_s) - low for k in range(periods)]
    )
    expected = low + lfilter([0.0, denominator.sum()], denominator, reference)
    assert np.allclose(ideal_output(experiment, "paper"), expected, rtol=0.0, atol=1e-12)


def test_the_model_error_of_the_ideal_output_is_nothing() -> None:
    record = square_record()
    record["output"][:] = ideal_output(MOTOR, "paper").tolist()
    assert not model_errors(MOTOR, "paper", record).any()
    record["output"][300] += 0.02
    errors = model_errors(MOTOR, "paper", record)
    assert rms_between(record, errors, 240.0, 360.0) == pytest.approx(0.1 / 120**0.5)
    assert rms_between(record, errors, 120.0, 240.0) == 0.0


def estimates_of(experiment: Experiment) -> Run:
    truth = np.array([experiment.truth_at(time_s) for time_s in TIMES]).T
    names = experiment.nominal().names
    return Run(np.column_stack((TIMES, *truth)), ("time_s", *names))


def test_estimates_have_converged_when_all_are_right_and_stay_so() -> None:
    record, (first, second) = estimates_of(MOTOR), MOTOR.changes
    record["gain"][659] *= 1.051
    record["tau_sum_s"][700] *= 1.049
    record["tau_product_s2"][965] *= 0.949
    assert convergence_cycles(MOTOR, record, first) == pytest.approx(60.0 / 120.0)
    assert convergence_cycles(MOTOR, record, second) == pytest.approx(6.0 / 120.0)
