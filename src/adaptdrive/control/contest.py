"""Contest of the two laws: what the law that is not in force would have done to the load.

The adaptive law can cost more than the fixed one although its estimate is right: it pays for noise
at a limit of the input, for a coarse sensor, for a delay that no model holds. So the law that is
not in force is replayed beside the one that is, on the last trusted model and on what was measured,

    A Δy = B Δu        u' = u + Δu,  y' = y + Δy,  u' from the other law on u' and y', limited

with everything in it that moved the real output: noise, torque, another load. Both outputs are
compared with the response that was asked for, B/B(1) A_m(1)/A_m r. The law in force is judged by
what it did, the other one by what it would have done.

An adaptive law that has lost waits, twice as long each time, and until its replay wins.
"""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.control.compensator import control_law
from adaptdrive.control.reference_filter import (
    ReferenceFilter,
    condition_reference,
    filter_reference,
)
from adaptdrive.control.ringing import Ringing
from adaptdrive.control.vectors import Vector, all_finite, copy_into, shift_in, total

_MOST_DOUBLINGS = 5
"""Doublings of the wait: 32 times as long as the first."""


@dataclass(slots=True)
class Contest:
    """State of the replay and of the comparison.

    Attributes:
        inputs: u'[k-1] ... u'[k-n].
        outputs: y'[k] ... y'[k-m].
        pushes: Δu[k-1] ... Δu[k-n].
        shifts: Δy[k] ... Δy[k-m].
        filter: Reference filter of the adaptive law while it is the one that is replayed.
        course: A_m(1)/A_m r, newest first.
        ringing: Detector of an input that swings.
        adaptive: Whether the adaptive law is in force, and the fixed one replayed.
        adaptive_cost: Mean squared error of the adaptive law.
        fixed_cost: Mean squared error of the fixed law.
        waiting_periods: Periods that the adaptive law has to wait.
        losses: How often it has lost.
        good_periods: Periods in force since the last loss.
        reference: r'[k-1].
    """

    inputs: Vector
    outputs: Vector
    pushes: Vector
    shifts: Vector
    filter: ReferenceFilter
    course: Vector
    ringing: Ringing
    adaptive: bool = False
    adaptive_cost: float = 0.0
    fixed_cost: float = 0.0
    waiting_periods: int = 0
    losses: int = 0
    good_periods: int = 0
    reference: float = 0.0


def start_replay(state: Contest, inputs: Vector, outputs: Vector, real: ReferenceFilter) -> None:
    """Let both laws have done the same until now.

    Args:
        state: Overwritten.
        inputs: u as applied, newest first.
        outputs: y, newest first.
        real: Reference filter of the adaptive law.
    """
    copy_into(state.inputs, inputs)
    copy_into(state.outputs, outputs)
    copy_into(state.filter.course, real.course)
    for i in range(len(state.pushes)):
        state.pushes[i] = 0.0
    for i in range(len(state.shifts)):
        state.shifts[i] = 0.0


def asked_output(state: Contest, asked: Vector, b: Vector, reference: float) -> float:
    """Return y[k] of the response that was asked for.

    Args:
        state: Its course is overwritten.
        asked: A_m; zeros before there is a design.
        b: B of the trusted model.
        reference: r'[k].
    """
    scale, at_one = total(asked), total(b)
    if scale == 0.0 or at_one == 0.0 or not all_finite(state.course):
        for i in range(len(state.course)):
            state.course[i] = reference
        return reference
    newest = scale * reference
    for i in range(1, len(asked)):
        newest -= asked[i] * state.course[i - 1]
    shift_in(state.course, newest)
    result = 0.0
    for i in range(len(b)):
        result += b[i] * state.course[i]
    return result / at_one


def replay_load(state: Contest, a: Vector, b: Vector, applied: float, output: float) -> None:
    """Move the replayed output by one period.

    Args:
        state: Overwritten.
        a: A of the trusted model.
        b: B of it.
        applied: u[k-1] as applied.
        output: y[k].
    """
    shift_in(state.pushes, state.inputs[0] - applied)
    moved = 0.0
    for i in range(1, len(a)):
        moved -= a[i] * state.shifts[i - 1]
    for i in range(1, len(b)):
        moved += b[i] * state.pushes[i - 1]
    shift_in(state.shifts, moved)
    shift_in(state.outputs, output + moved)


def replay_law(
    state: Contest, gains: Vector, reference: float, low: float, high: float, *, filtered: bool
) -> None:
    """Let the law that is not in force decide on its own history.

    Args:
        state: Overwritten.
        gains: Its gains.
        reference: r'[k].
        low: Lowest input.
        high: Highest input.
        filtered: Whether the law has a reference filter.
    """
    asked = filter_reference(state.filter, reference) if filtered else reference
    wanted = control_law(gains, state.inputs, state.outputs, asked)
    limited = min(max(wanted, low), high)
    if filtered:
        condition_reference(state.filter, limited - wanted, total(gains[len(state.inputs) :]))
    shift_in(state.inputs, limited)


def weigh(state: Contest, output: float, asked: float, rate: float) -> None:
    """Follow what the laws cost.

    Args:
        state: Overwritten.
        output: y[k].
        asked: y[k] of the response that was asked for.
        rate: One over the periods of the mean.
    """
    real, other = (output - asked) ** 2, (state.outputs[0] - asked) ** 2
    adaptive, fixed = (real, other) if state.adaptive else (other, real)
    state.adaptive_cost += rate * (adaptive - state.adaptive_cost)
    state.fixed_cost += rate * (fixed - state.fixed_cost)


def lose(state: Contest, periods: int) -> None:
    """Let the adaptive law wait.

    Args:
        state: Overwritten.
        periods: How long after the first loss.
    """
    waiting = periods << min(state.losses, _MOST_DOUBLINGS)
    state.waiting_periods = max(state.waiting_periods, waiting)
    state.losses += 1
    state.good_periods = 0


def wait(state: Contest) -> None:
    """Let one period of the wait pass; the last one when the replayed law wins."""
    wins = state.adaptive_cost < state.fixed_cost
    if state.waiting_periods > 1 or (state.waiting_periods == 1 and wins):
        state.waiting_periods -= 1


def forgive(state: Contest, periods: int) -> None:
    """Forget a loss that lies far behind.

    Args:
        state: Overwritten.
        periods: How long the adaptive law must have been in force since.
    """
    state.good_periods += 1 if state.adaptive else 0
    if state.good_periods > periods:
        state.losses, state.good_periods = max(0, state.losses - 1), 0
