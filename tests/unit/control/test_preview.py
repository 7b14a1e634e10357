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

from adaptdrive.control.design.pole_placement import Plant, discrete_model
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
        self.plant = Plant(*discrete_model(EXACT, MOTOR, *values, 1.0))
        self.a, self.b = self.plant.a, self.plant.b
        self.asked = self.plant.asked(POLE)
        self.state = ReferenceFilter(2, len(self.b) - 1)
        self.state.asked = self.asked
        self.state.course, self.state.ideal = [REST] * 7, [REST] * 7
        self.last, self.free, self.beyond = REST / self.gain, True, beyond

    @property
    def course(self) -> list[float]:
        return self.state.course

    @property
    def gain(self) -> float:
        return sum(self.b) / sum(self.a)

    def step(self, references: list[float]) -> float:
        """One slow period; the input that the new course needs."""
        found = plan(
            self.state,
            self.plant,
            references,
            self.last,
            free=self.free,
            pole=POLE,
            low=LOW,
            high=HIGH,
            beyond=self.beyond,
        )
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
    assert abs(far.course[0] - REST) > 1e-4


@pytest.mark.parametrize("edge", [1, 3, 6, 12])
def test_the_plan_is_the_bounded_least_squares_of_its_course(edge: int) -> None:
    loop = Loop(3.0)
    references = [REST] * edge + [4.3] * (AHEAD - edge)
    held = np.zeros((AHEAD, len(MOVES) - 1))
    for i, (begin, end) in enumerate(pairwise(MOVES)):
        held[begin:end, i] = 1.0
    impulse = lfilter([sum(loop.b)], loop.a, np.eye(1, AHEAD)[0])
    moves = toeplitz(impulse, np.zeros(AHEAD))
    rest, asked = REST / loop.gain, np.array(law(loop, references)) - REST
    limited = np.clip(rest + lfilter(loop.a, [sum(loop.b)], asked), LOW, HIGH)
    gap = asked - moves @ (limited - rest)
    price = math.sqrt(UNREST) * loop.gain * np.eye(len(MOVES) - 1)
    parts = [limited[begin:end] for begin, end in pairwise(MOVES)]
    best = lsq_linear(
        np.vstack([moves @ held, price]),
        np.concatenate([gap, np.zeros(len(MOVES) - 1)]),
        ([LOW - min(part) - 1e-9 for part in parts], [HIGH - max(part) + 1e-9 for part in parts]),
        method="bvls",
    )
    assert loop.step(references) == pytest.approx(limited[0] + best.x[0], abs=1e-3)


@pytest.mark.parametrize("top", [3.15, 3.2, 3.6])
@pytest.mark.parametrize("disks", [1.0, 2.0, 3.0])
def test_a_square_wave_at_a_limit_overshoots_by_a_hundredth_at_most(
    top: float, disks: float
) -> None:
    """The next edge, 30 periods away, does not move the response to this one."""
    late = np.array(courses(disks, ([REST] * 30 + [top] * 30) * 4)[30:])
    assert REST - 0.01 * (top - REST) <= late.min() <= late.max() <= top + 0.01 * (top - REST)


@pytest.mark.parametrize("disks", [1.0, 2.0])
def test_it_does_not_go_beyond_a_level_to_be_sooner_at_the_next(disks: float) -> None:
    low, high = 2.5, 4.0
    late = np.array(courses(disks, [REST] * 60 + ([high] * 60 + [low] * 60) * 3)[180:])
    assert low - 1e-9 <= late.min() <= late.max() <= high + 1e-9


def courses(disks: float, wave: list[float]) -> list[float]:
    """The planned course under a waveform, as far as what comes is known."""
    loop, found = Loop(disks), []
    for k in range(len(wave) - AHEAD):
        loop.step(wave[k : k + AHEAD])
        found.append(loop.course[0])
    return found


def stepped(
    upcoming: list[float], adaptive: bool = True, steps: int = 6, *, exact: bool = True
) -> SlowState:
    """A slow half at rest that knows what comes."""
    settings = replace(SETTINGS, exact=exact)
    state = known(settings)
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


def least(count: int) -> list[float]:
    """Lower limits, one of them above 0."""
    return [0.5 - 1.5 * (i % 3) for i in range(count)]


def most(count: int) -> list[float]:
    """Upper limits, one of them below 0."""
    return [2.0 - 1.1 * (i % 3) for i in range(count)]


def problem(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a least-squares problem with decaying influence, as moves further ahead have it."""
    generator = np.random.default_rng(seed)
    rows = generator.standard_normal((count + 8, count)) * 0.6 ** np.arange(count)
    return rows, 3.0 * generator.standard_normal(count + 8)


def found(rows: np.ndarray, aims: np.ndarray) -> np.ndarray:
    flat = (rows.T @ rows).ravel().tolist()
    count = rows.shape[1]
    return np.array(minimise(flat, (rows.T @ aims).tolist(), least(count), most(count)))


@given(st.integers(0, 10**6), st.integers(1, 8))
def test_it_is_the_bounded_least_squares(seed: int, count: int) -> None:
    rows, aims = problem(seed, count)
    limits = np.array(least(count)), np.array(most(count))
    best = lsq_linear(rows, aims, limits, method="bvls", tol=1e-14).x
    x = found(rows, aims)
    assert x == pytest.approx(best, abs=1e-6)
    assert np.all((x >= limits[0]) & (x <= limits[1]))
