from collections.abc import Iterable
from itertools import accumulate

import pytest
from crccheck.crc import Crc8GsmA
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config.bus import FrameIntegrity
from adaptdrive.devices.can.integrity import AliveCounter, Checksum, FrameVerdict, checksum_function


def autosar(data_id: int, mode: str) -> Checksum:
    form: dict[str, object] = {"data_id": data_id}
    form |= {"nibble": "Half"} if mode == "nibble" else {"data_id_mode": mode}
    return checksum_function(FrameIntegrity.model_validate(form))


def id_bytes(data_id: int, mode: str, counter: int) -> bytes:
    """What the standard puts in front of a frame."""
    low, high = data_id & 0xFF, data_id >> 8
    if mode == "alternating":
        return bytes((high if counter % 2 else low,))
    return bytes({"both": (low, high), "low": (low,), "nibble": (low, 0)}[mode])


@given(
    st.binary(max_size=64),
    st.integers(0, 0xFFFF),
    st.sampled_from(["both", "alternating", "low", "nibble"]),
    st.integers(0, 14),
)
def test_autosar_runs_over_the_data_id_first(
    data: bytes, data_id: int, mode: str, counter: int
) -> None:
    # crccheck calls the polynomial 0x1D with start 0 and no final XOR "GSM A"
    expected = Crc8GsmA.calc(id_bytes(data_id, mode, counter) + data)
    assert autosar(data_id, mode)(data, counter) == expected


@pytest.mark.parametrize(
    ("mode", "frame"),
    [
        ("both", "cc00000000000000"),  # these two are printed in the standard
        ("both", "9101000000000000"),
        ("alternating", "ce00000000000000"),  # and these were made by the package autosar-e2e 1.0.0
        ("alternating", "0201000000000000"),
        ("low", "ce00000000000000"),
        ("low", "9301000000000000"),
        ("nibble", "2a10000000000000"),
        ("nibble", "7711000000000000"),
    ],
)
def test_autosar_meets_the_frames_of_others(mode: str, frame: str) -> None:
    # data id 0x123, the checksum in byte 0, the counter in the lower half of byte 1
    data = bytes.fromhex(frame)
    assert autosar(0x123, mode)(data[1:], data[1] & 0xF) == data[0]


@given(st.integers(2, 256), st.data())
def test_a_counter_is_judged_by_its_advance(modulus: int, data: st.DataObject) -> None:
    max_jump = data.draw(st.integers(1, modulus - 1))
    start = data.draw(st.integers(0, modulus - 1))
    jump = data.draw(st.integers(0, modulus - 1))
    counter = AliveCounter(modulus, max_jump)
    assert counter.check(start) == (FrameVerdict.GOOD, 0)
    verdict, lost = counter.check((start + jump) % modulus)
    if jump == 0:
        assert (verdict, lost) == (FrameVerdict.COUNTER_STUCK, 0)
    else:
        assert verdict is (FrameVerdict.GOOD if jump <= max_jump else FrameVerdict.COUNTER_LOST)
        assert lost == jump - 1


@pytest.mark.parametrize("ahead", [2, 3, 4, 8, 13, 15])
def test_of_two_senders_that_take_turns_neither_is_believed(ahead: int) -> None:
    """A gateway that repeats each frame late: its counter seems to be ahead of the drive's."""
    counter = AliveCounter(16, max_jump=3)
    frames = [value % 16 for now in range(40) for value in (now, now + ahead)]
    verdicts = [counter.check(value)[0] for value in frames]
    assert set(verdicts[4:]) == {FrameVerdict.COUNTER_LOST}


def judge(counter: AliveCounter, values: Iterable[int], modulus: int) -> list[FrameVerdict]:
    return [counter.check(value % modulus)[0] for value in values]


@pytest.mark.parametrize("modulus", [15, 16, 256])
@pytest.mark.parametrize("held", [2, 3, 4, 5, 7])
@pytest.mark.parametrize("end", [0, 3, 14])
def test_frames_that_are_repeated_in_turn_are_soon_believed_no_more(
    modulus: int, held: int, end: int
) -> None:
    """Buffers of a drive that hangs, or of a gateway: each is the next of the one before."""
    counter = AliveCounter(modulus, max_jump=3)
    judge(counter, range(end - modulus, end + 1), modulus)
    turn = range(end + 1 - held, end + 1)
    first, *others = (judge(counter, turn, modulus) for _ in range(20))
    assert FrameVerdict.GOOD not in first or held > modulus // 4
    assert {verdict for one in others for verdict in one} == {FrameVerdict.COUNTER_LOST}
    again = judge(counter, range(end + 1, end + 1 + 2 * modulus), modulus)  # the drive goes on
    assert set(again[1:]) == {FrameVerdict.GOOD}


@pytest.mark.parametrize(("cycle_s", "lost"), [(0.01, 8), (0.02, 5), (0.05, 2), (0.5, 1)])
@pytest.mark.parametrize("behind", [2, 4, 7])
def test_a_sender_of_a_slow_message_that_starts_anew_loses_a_tenth_of_a_second_or_one_frame(
    cycle_s: float, lost: int, behind: int
) -> None:
    counter = AliveCounter(256, 3, cycle_s)
    judge(counter, range(100), 256)
    verdicts = judge(counter, range(99 - behind, 200), 256)
    refused = verdicts.count(FrameVerdict.COUNTER_LOST)
    assert refused == (behind + 1 if behind < lost else 1)
    in_turn = [judge(counter, range(198, 200), 256) for _ in range(20)]
    assert {verdict for one in in_turn[1:] for verdict in one} == {FrameVerdict.COUNTER_LOST}


@pytest.mark.parametrize("held", [2, 3, 4])
def test_frames_that_are_repeated_in_turn_are_not_believed_after_a_pause(held: int) -> None:
    counter = AliveCounter(16, max_jump=3)
    judge(counter, range(8), 16)
    counter.resume()
    verdicts = {one for _ in range(20) for one in judge(counter, range(8 - held, 8), 16)}
    assert FrameVerdict.GOOD not in verdicts
    assert judge(counter, [8, 9], 16) == [FrameVerdict.GOOD] * 2


@given(st.sampled_from([4, 15, 16, 256, 65536]), st.integers(0), st.integers(0), st.integers(2, 9))
def test_a_sender_that_starts_anew_loses_a_few_frames_alone(
    modulus: int, before: int, start: int, after: int
) -> None:
    """As many as were among the newest ones, a quarter of the range and eight at the most."""
    counter = AliveCounter(modulus, max_jump=min(3, modulus - 1))
    judge(counter, range(before % modulus + 1), modulus)
    verdicts = judge(counter, range(start, start + after * modulus), modulus)
    assert set(verdicts[min(8, max(1, modulus // 4)) :]) == {FrameVerdict.GOOD}


def test_a_sender_that_has_been_ahead_is_followed_back_again() -> None:
    """After frames in turn, and after each of several restarts."""
    counter = AliveCounter(16, max_jump=3)
    judge(counter, range(10), 16)
    assert counter.check(8) == (FrameVerdict.COUNTER_LOST, 14)
    counter.reset()
    for _ in range(3):
        judge(counter, range(10), 16)
        assert set(judge(counter, [*range(3, 10)] * 3, 16)[7:]) == {FrameVerdict.COUNTER_LOST}
        judge(counter, range(10, 16), 16)
        for start in (9, 10, 11, 12):
            verdicts = judge(counter, range(start, start + 8), 16)
            assert verdicts == [FrameVerdict.COUNTER_LOST, *[FrameVerdict.GOOD] * 7]
        judge(counter, range(20, 32), 16)


@pytest.mark.parametrize("modulus", [15, 16, 256])
def test_one_frame_from_elsewhere_costs_a_few_at_the_most(modulus: int) -> None:
    """It may lie shortly ahead, so that those after it are among the newest ones."""
    for elsewhere in range(8, modulus + 4):
        counter = AliveCounter(modulus, max_jump=3)
        judge(counter, range(5), modulus)
        counter.check(elsewhere % modulus)
        verdicts = judge(counter, range(5, 300), modulus)
        assert set(verdicts[min(8, modulus // 4 + 1) :]) == {FrameVerdict.GOOD}


@given(st.sampled_from([4, 8, 15, 16, 256]), st.lists(st.integers(1, 3), max_size=600))
def test_lost_frames_within_the_bound_are_no_repeated_ones(modulus: int, jumps: list[int]) -> None:
    counter = AliveCounter(modulus, max_jump=3)
    verdicts = judge(counter, accumulate(jumps, initial=0), modulus)
    assert set(verdicts) == {FrameVerdict.GOOD}


@pytest.mark.parametrize("after", [0, 1, 9, 15])
def test_after_a_pause_any_counter_but_the_last_is_the_first(after: int) -> None:
    counter = AliveCounter(16, max_jump=1)
    counter.check(5)
    counter.resume()
    for _ in range(3):
        assert counter.check(5) == (FrameVerdict.COUNTER_STUCK, 0)
    assert counter.check(after) == (FrameVerdict.GOOD, 0)
    assert counter.check((after + 2) % 16) == (FrameVerdict.COUNTER_LOST, 1)


def test_before_the_first_counter_a_pause_changes_nothing() -> None:
    counter = AliveCounter(16, max_jump=1)
    counter.resume()
    assert [counter.check(value)[0] for value in (5, 6)] == [FrameVerdict.GOOD] * 2
    assert counter.check(9) == (FrameVerdict.COUNTER_LOST, 2)
