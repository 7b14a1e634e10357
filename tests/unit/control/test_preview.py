"""Preview: the plan against scipy, and the law where it keeps the limits."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import toeplitz
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from adaptdrive.control.design.pole_placement import asked_loop, discrete_model
from adaptdrive.control.design.reference import (
    AHEAD,
    MOVES,
    UNREST,
    ReferenceFilter,
    minimise,
    plan,
)
from adaptdrive.control.slow import slow_step
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.control.vectors import shift_in
from tests.integration.closed_loop.bench import EXACT, MOTOR
from tests.unit.control.test_slow_half import SAMPLE, SETTINGS, known

LOW, HIGH, POLE, REST = 200.0, 400.0, 0.7, 3.0
DISKS = st.floats(0.3, 4.0)
LEVELS = st.floats(2.3, 4.4)


class Loop:
    """A motor on the course that is planned, without noise."""

    def __init__(self, disks: float, beyond: float = 0.0) -> None:
        values = MOTOR.realise([0.011, 10.0 + 11.7 * disks, 117.0 * disks])
        self.a, self.b = discrete_model(EXACT, MOTOR, *values, 1.0)
        self.asked = asked_loop(self.b, 2, POLE)
        self.state = ReferenceFilter(self.asked, [], [REST] * 7, [REST] * 7)
        self.last, self.free, self.beyond = REST / self.gain, True, beyond

    @property
    def course(self) -> list[float]:
        return self.state.course

    @property
    def gain(self) -> float:
        return sum(self.b) / sum(self.a)

    def step(self, references: list[float]) -> float:
        """One slow period; the input that the new course needs."""
        known = (self.a, self.b, references)
        limits = (POLE, LOW, HIGH, self.beyond)
        found = plan(self.state, *known, self.last, self.free, *limits)
        shift_in(self.course, found)
        self.last = float(np.dot(self.a, self.course[: len(self.a)])) / sum(self.b)
        return self.last


def law(loop: Loop, references: list[float]) -> list[float]:
    """Course of the law from rest."""
    moved = np.array(references) - REST
    return list(REST + lfilter([sum(loop.asked)], loop.asked, moved))


@given(DISKS, LEVELS, st.integers(1, AHEAD + 8))
def test_the_input_of_the_plan_never_leaves_the_limits(
    disks: float, level: float, edge: int
) -> None:
    loop = Loop(disks)
    references = [REST] * edge + [level] * (2 * AHEAD)
    for k in range(AHEAD):
        assert LOW - 1e-6 <= loop.step(references[k : k + AHEAD]) <= HIGH + 1e-6


@given(DISKS)
def test_without_a_change_to_come_it_is_the_law(disks: float) -> None:
    loop = Loop(disks)
    for _ in range(5):
        assert loop.step([REST] * AHEAD) == pytest.approx(REST / loop.gain, rel=1e-9)
    assert loop.state.moved == pytest.approx(0.0, abs=1e-9)


@given(st.floats(2.98, 3.02), st.integers(1, AHEAD))
def test_a_step_within_the_limits_is_answered_by_the_law_alone(level: float, edge: int) -> None:
    loop = Loop(1.0)
    references = [REST] * edge + [level] * (3 * AHEAD)
    for k in range(AHEAD):
        loop.step(references[k : k + AHEAD])
        assert loop.course[0] == pytest.approx(law(loop, references)[k], abs=1e-9)


def test_without_limits_in_the_way_it_does_not_move_before_the_edge() -> None:
    near, far = Loop(1.0), Loop(3.0)
    for k in range(10):
        near.step(([REST] * 20 + [3.01] * AHEAD)[k : k + AHEAD])
        far.step(([REST] * 20 + [4.3] * AHEAD)[k : k + AHEAD])
    assert near.course[0] == pytest.approx(REST, abs=1e-9)
    assert abs(far.course[0] - REST) > 1e-3


@pytest.mark.parametrize("edge", [1, 3, 6, 12])
def test_the_plan_is_the_bounded_least_squares_of_its_course(edge: int) -> None:
    loop = Loop(3.0)
    references = [REST] * edge + [4.3] * (AHEAD - edge)
    answer = lfilter([sum(loop.b)], loop.a, np.ones(AHEAD))
    held = np.zeros((AHEAD, len(MOVES) - 1))
    for i, (begin, end) in enumerate(pairwise(MOVES)):
        held[begin:end, i] = 1.0
    impulse = np.diff(answer, prepend=0.0)
    rows = toeplitz(impulse, np.zeros(AHEAD)) @ held
    price = math.sqrt(UNREST) * loop.gain
    changes = price * (np.eye(len(MOVES) - 1) - np.eye(len(MOVES) - 1, k=-1))
    aims = np.array(law(loop, references)) - REST
    rest = REST / loop.gain
    limits = (LOW - rest, HIGH - rest)
    best = lsq_linear(
        np.vstack([rows, changes]),
        np.concatenate([aims, np.zeros(len(MOVES) - 1)]),
        limits,
        method="bvls",
    )
    assert loop.step(references) == pytest.approx(rest + best.x[0], abs=1e-3)


def stepped(
    upcoming: list[float], adaptive: bool = True, steps: int = 6, *, exact: bool = True
) -> SlowState:
    """A slow half at rest that knows what comes."""
    state, settings = known(), replace(SETTINGS, exact=exact)
    for _ in range(steps):
        sample = replace(SAMPLE, upcoming=upcoming, adaptive=adaptive)
        slow_step(settings, MOTOR, state, sample)
    return state


def test_the_adaptive_law_moves_before_an_edge_that_it_cannot_follow() -> None:
    edge = [REST] * 6 + [4.4] * (AHEAD - 7)
    assert stepped(edge, steps=12).sent != pytest.approx(stepped([], steps=12).sent, abs=1.0)


def test_the_fixed_law_and_the_papers_design_know_nothing_of_it() -> None:
    edge = [REST] * 6 + [4.4] * (AHEAD - 7)
    assert stepped(edge, adaptive=False).inputs == stepped([], adaptive=False).inputs
    assert stepped(edge, exact=False).inputs == stepped([], exact=False).inputs


LEAST, MOST = -1.0, 2.0


def problem(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a least-squares problem with decaying influence, as moves further ahead have it."""
    generator = np.random.default_rng(seed)
    rows = generator.standard_normal((count + 8, count)) * 0.6 ** np.arange(count)
    return rows, 3.0 * generator.standard_normal(count + 8)


def found(rows: np.ndarray, aims: np.ndarray) -> np.ndarray:
    flat = (rows.T @ rows).ravel().tolist()
    return np.array(minimise(flat, (rows.T @ aims).tolist(), LEAST, MOST))


@given(st.integers(0, 10**6), st.integers(1, 8))
def test_it_is_the_bounded_least_squares(seed: int, count: int) -> None:
    rows, aims = problem(seed, count)
    best = lsq_linear(rows, aims, (LEAST, MOST), method="bvls", tol=1e-14).x
    x = found(rows, aims)
    assert x == pytest.approx(best, abs=1e-6)
    assert np.all((x >= LEAST) & (x <= MOST))
