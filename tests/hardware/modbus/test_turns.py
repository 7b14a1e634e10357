"""Order of the requests on a sensor link whose cycle has no time left for a missing reply."""

from __future__ import annotations

from collections.abc import Set as AbstractSet

from adaptdrive.hardware.modbus.sensors import SELDOM_CYCLES, SensorBlock, Turns
from adaptdrive.hardware.polled.capacity import Block, Exchange

Asked = list[tuple[int | None, int]]


def turns_of(*devices: int, blocks: int = 1) -> Turns:
    """Turns of devices with as many blocks each, silent after three missing replies."""
    return Turns(
        tuple(
            SensorBlock(Exchange(read=Block("input", address, 1), device_id=device), ())
            for device in devices
            for address in range(blocks)
        ),
        3,
    )


def cycle(turns: Turns, dead: AbstractSet[int | None]) -> Asked:
    """Device and address of each request of a cycle that the first missing reply uses up."""
    asked: Asked = []
    left_s = [0.5]
    for turn in turns.due(lambda: left_s[-1], 1.0):
        answered = turn.exchange.device_id not in dead
        left_s.append(left_s[-1] if answered else -1.0)
        turns.note(turn, answered=answered)
        read = turn.exchange.read
        assert read is not None
        asked.append((turn.exchange.device_id, read.address))
    return asked


def test_silent_modules_take_turns_of_ten_cycles() -> None:
    turns = turns_of(1, 2, 3, 4)
    for _ in range(30):
        cycle(turns, {1, 2, 3})
    cycles = [cycle(turns, {1, 2, 3}) for _ in range(3 * SELDOM_CYCLES)]
    assert all(asked[0] == (4, 0) for asked in cycles)
    assert all(len(asked) <= 2 for asked in cycles)
    assert sorted(asked[1][0] or 0 for asked in cycles if len(asked) > 1) == [1, 2, 3]


def test_after_the_first_cycle_modules_that_fall_silent_together_cost_one_reply_a_cycle() -> None:
    turns = turns_of(1, 2, 3, 4, blocks=3)
    cycle(turns, {1, 2, 3})
    cycles = [cycle(turns, {1, 2, 3}) for _ in range(100)]
    assert all(asked.count((4, 1)) == 1 for asked in cycles)
    several = [asked for asked in cycles if sum(device != 4 for device, _ in asked) > 1]
    assert len(several) <= 2  # their other blocks, which no reply is known to be missing of yet


def test_every_block_of_a_module_that_is_found_again_is_asked_in_that_cycle() -> None:
    turns = turns_of(1, 2, blocks=3)
    for _ in range(30):
        cycle(turns, {1})
    found = next(asked for asked in (cycle(turns, set()) for _ in range(11)) if len(asked) > 3)
    assert [device for device, _ in found] == [2, 2, 2, 1, 1, 1]
    assert len(cycle(turns, set())) == 6


def test_modules_that_are_all_silent_are_asked_one_in_each_cycle() -> None:
    turns = turns_of(1, 2, 3)
    for _ in range(30):
        cycle(turns, {1, 2, 3})
    assert sorted(cycle(turns, {1, 2, 3})[0][0] or 0 for _ in range(3)) == [1, 2, 3]
