"""A failure on a wire whose both ends stood still is not judged, and no other is hidden."""

from __future__ import annotations

import asyncio
import time

import pytest

from tests.hardware.modbus.bench import Stalls, judged

FAILURE = "a reply was taken for another"


async def failing(permitted_s: float, error: Exception, stall_s: float = 0.0) -> None:
    """Fail in a block that is judged, after a standstill."""
    async with judged(permitted_s):
        await asyncio.sleep(0.02)
        time.sleep(stall_s)  # noqa: ASYNC251 - the process is what stands still
        await asyncio.sleep(0.02)
        raise error


async def test_a_failure_without_a_standstill_is_one() -> None:
    with pytest.raises(AssertionError, match=FAILURE):
        await failing(60.0, AssertionError(FAILURE))


async def test_a_failure_after_a_longer_standstill_is_not_judged() -> None:
    with pytest.raises(pytest.skip.Exception, match=r"not judged: stalled for \d\.\d+ s"):
        await failing(0.05, AssertionError(FAILURE), 0.1)


async def test_another_error_is_one_whatever_stood_still() -> None:
    with pytest.raises(TimeoutError):
        await failing(0.0, TimeoutError(), 0.1)


def test_standstills_just_before_a_failure_add_up_and_no_others_count() -> None:
    stalls = Stalls()
    for now_s, passed_s in ((1.0, 0.3), (1.8, 0.03), (1.9, 0.004), (2.0, 0.05)):
        stalls.note(now_s, passed_s)
    assert stalls.before(2.1) == pytest.approx(0.08)
