"""Content of the figures of an experiment: what is drawn, that nothing is cut, what is named."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from adaptdrive.analysis import figures
from adaptdrive_sim.experiments.case import Variant
from adaptdrive_sim.experiments.experiment import DROPPED, LoadChange
from adaptdrive_sim.experiments.figure import experiment_figure
from adaptdrive_sim.experiments.outcome import Outcome
from tests.unit.simulators.experiments import cases

SHORT = dataclasses.replace(
    DROPPED, duration_s=240.0, changes=(LoadChange(120.0, 2.0), LoadChange(180.0, 3.0))
)
VARIANTS: tuple[Variant, ...] = ("fixed", "adaptive", "direct_rls")


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    return cases.outcome(SHORT, VARIANTS, seed=81_200)


@pytest.fixture(scope="module")
def figure(outcome: Outcome) -> Figure:
    with figures.journal():
        drawn = experiment_figure(outcome)
        FigureCanvasAgg(drawn).draw()  # type: ignore[no-untyped-call]
    return drawn


def line(axes: Axes, label: str) -> list[float]:
    (found,) = [one for one in axes.lines if one.get_label() == label]
    return [float(value) for value in np.asarray(found.get_ydata())]


def test_each_controller_has_its_speed_and_its_voltage(outcome: Outcome, figure: Figure) -> None:
    for i, variant in enumerate(VARIANTS):
        speed, voltage = figure.axes[2 * i], figure.axes[2 * i + 1]
        record = outcome.records[variant]
        assert line(speed, "without noise") == record["output"].tolist()
        assert line(speed, "measured") == record["measured"].tolist()
        assert line(speed, "reference") == record["reference"].tolist()
        assert line(voltage, r"$V_c$ commanded") == record["boost_reference_V"].tolist()
        assert line(voltage, r"$v_{bst}$ applied")[:-1] == record["applied_V"][1:].tolist()


def test_nothing_is_cut(figure: Figure) -> None:
    for panel in (0, 1, 2, 3, 4, 5, 7):
        axes = figure.axes[panel]
        low, high = axes.get_ylim()
        for one in axes.lines:
            if one.get_transform() == axes.transData:
                values = np.asarray(one.get_ydata(), dtype=float)
                assert low <= values.min(), one.get_label()
                assert values.max() <= high, one.get_label()
