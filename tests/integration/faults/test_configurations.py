"""Whatever a valid configuration holds, its daemon runs; it trips at worst, and says why.

CONFIGURATIONS of the environment draws more of them.
"""

from __future__ import annotations

import math
import os
import random
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adaptdrive.control.signals import Mode
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Request,
    SetMode,
    SetPole,
    SetSetpoint,
    SetVoltage,
)
from tests.integration.faults.configurations import Tables, configurations
from tests.integration.faults.course import FILES, Course

SPAN_s = 200.0
"""Longest time between two requests of an operator."""


def wish(course: Course, draw: random.Random) -> Request:
    """Return what an operator may want next."""
    low, high = course.reach
    setpoint = SetSetpoint(draw.uniform(low, max(low, high)))
    return draw.choice(
        [
            setpoint,
            setpoint,
            SetMode(draw.choice(list(Mode))),
            SetVoltage(draw.uniform(200.0, 400.0)),
            SetPole(draw.uniform(0.5, 0.98)),
            Disable(),
            Enable(),
        ]
    )


def live(course: Course, draw: random.Random) -> None:
    """Let an operator work with a drive, and mend each trip."""
    period_s = course.configuration.load.period_s
    course.run(draw.choice([0.7, 3.0]))
    course.daemon.accepts(SetMode(draw.choice([Mode.FIXED, Mode.ADAPTIVE])))
    course.daemon.accepts(Enable())
    for _ in range(6):
        course.run(min(draw.uniform(3.0, 40.0) * max(period_s, 0.3), SPAN_s))
        if course.daemon.state is State.TRIPPED:
            assert not (course.daemon.trip or "").startswith(("internal error", "command cannot"))
            course.recovers()
        course.daemon.accepts(wish(course, draw))


@pytest.mark.proof
@pytest.mark.parametrize("name", list(FILES))
@settings(
    max_examples=int(os.environ.get("CONFIGURATIONS", "4")),
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
@given(data=st.data())
def test_a_valid_configuration_ends_no_daemon(name: str, data: Any) -> None:
    tables: Tables = data.draw(configurations(name))
    seed = data.draw(st.integers(0, 1_000_000))
    course = Course(name, seed, tables)
    live(course, course.draw)
    assert all(math.isfinite(one.boost_reference_V) for one in course.commands)
