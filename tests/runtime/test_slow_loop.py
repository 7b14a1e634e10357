"""The slow loop: every snapshot in its order, and never in the way."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest

from adaptdrive.control.signals import Decision, Snapshot
from adaptdrive.runtime.slow_loop import SlowLoop
from tests.runtime.bench import decision, snapshot, until


class Decider:
    """Answers each snapshot with its own number."""

    def decide(self, snapshot: Snapshot) -> Decision:
        if snapshot.k < 0:
            raise ArithmeticError("k is negative")
        return decision(snapshot.k, 200.0 + snapshot.k)


@contextlib.asynccontextmanager
async def running(slow: SlowLoop) -> AsyncIterator[asyncio.Task[None]]:
    task = asyncio.create_task(slow.run())
    try:
        yield task
    finally:
        task.cancel()
        await asyncio.wait([task])


@pytest.fixture
def delivered() -> list[tuple[Snapshot, Decision]]:
    return []


@pytest.fixture
def slow(delivered: list[tuple[Snapshot, Decision]]) -> SlowLoop:
    return SlowLoop(Decider().decide, lambda *pair: delivered.append(pair))


async def test_snapshots_are_decided_in_their_order(
    slow: SlowLoop, delivered: list[tuple[Snapshot, Decision]]
) -> None:
    async with running(slow):
        for k in range(1, 10):
            assert slow.offer(snapshot(k))
            await asyncio.sleep(0)
        await until(lambda: len(delivered) == 9)
    assert [taken.k for taken, _ in delivered] == list(range(1, 10))
    assert [made.boost_reference_V for _, made in delivered] == [201.0 + k for k in range(9)]


async def test_offering_never_waits_and_says_when_it_is_hopeless(slow: SlowLoop) -> None:
    assert [slow.offer(snapshot(k)) for k in range(5)] == [True, True, True, False, False]


async def test_what_waited_is_decided_after_a_delay_in_the_same_order(
    slow: SlowLoop, delivered: list[tuple[Snapshot, Decision]]
) -> None:
    for k in range(5):
        slow.offer(snapshot(k))
    async with running(slow):
        await until(lambda: len(delivered) == 3)
    assert [taken.k for taken, _ in delivered] == [0, 1, 2]


async def test_what_is_forgotten_is_never_decided(
    slow: SlowLoop, delivered: list[tuple[Snapshot, Decision]]
) -> None:
    async with running(slow):
        await asyncio.sleep(0)
        slow.offer(snapshot(1))
        slow.forget()
        slow.offer(snapshot(2))
        await until(lambda: bool(delivered))
    assert [taken.k for taken, _ in delivered] == [2]


async def test_a_failing_decision_ends_the_loop(slow: SlowLoop) -> None:
    slow.offer(snapshot(-1))
    with pytest.raises(ArithmeticError):
        await slow.run()
