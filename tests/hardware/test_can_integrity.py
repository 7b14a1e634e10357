import pytest
from crccheck.crc import Crc8GsmA, Crc8SaeJ1850
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.hardware.can.integrity import AliveCounter, Verdict, checksum_function


@given(st.binary(max_size=64))
def test_sae_j1850_agrees_with_crccheck(data: bytes) -> None:
    assert checksum_function("sae-j1850", 0)(data) == Crc8SaeJ1850.calc(data)


@given(st.binary(max_size=64), st.integers(0, 0xFFFF))
def test_autosar_runs_over_the_data_id_first(data: bytes, data_id: int) -> None:
    # crccheck calls the polynomial 0x1D with start 0 and no final XOR "GSM A"
    expected = Crc8GsmA.calc(bytes((data_id & 0xFF, data_id >> 8)) + data)
    assert checksum_function("autosar-p01", data_id)(data) == expected


@pytest.mark.parametrize(("counter", "checksum"), [(0, 0xCC), (1, 0x91)])
def test_autosar_meets_the_examples_of_its_standard(counter: int, checksum: int) -> None:
    # data id 0x123, eight zero bytes, the counter in byte 1 and the checksum in byte 0
    assert checksum_function("autosar-p01", 0x123)(bytes((counter,)) + bytes(6)) == checksum


def test_the_published_check_value() -> None:
    assert checksum_function("sae-j1850", 0)(b"123456789") == 0x4B


@given(st.integers(2, 256), st.data())
def test_a_counter_is_judged_by_its_advance(modulus: int, data: st.DataObject) -> None:
    max_jump = data.draw(st.integers(1, modulus - 1))
    start = data.draw(st.integers(0, modulus - 1))
    jump = data.draw(st.integers(0, modulus - 1))
    counter = AliveCounter(modulus, max_jump)
    assert counter.check(start) == (Verdict.GOOD, 0)
    verdict, lost = counter.check((start + jump) % modulus)
    if jump == 0:
        assert (verdict, lost) == (Verdict.COUNTER_STUCK, 0)
    else:
        assert verdict is (Verdict.GOOD if jump <= max_jump else Verdict.COUNTER_LOST)
        assert lost == jump - 1


def test_one_refusal_is_the_price_of_a_restarted_sender() -> None:
    counter = AliveCounter(16, max_jump=3)
    verdicts = [counter.check(value)[0] for value in (1, 2, 9, 10, 11)]
    assert verdicts == [Verdict.GOOD, Verdict.GOOD, Verdict.COUNTER_LOST, *[Verdict.GOOD] * 2]


def test_a_repeated_frame_does_not_stop_the_ones_that_follow() -> None:
    counter = AliveCounter(16, max_jump=1)
    verdicts = [counter.check(value)[0] for value in (15, 15, 15, 0)]
    assert verdicts == [Verdict.GOOD, *[Verdict.COUNTER_STUCK] * 2, Verdict.GOOD]


def test_after_a_reset_any_counter_is_the_first() -> None:
    counter = AliveCounter(16, max_jump=1)
    counter.check(5)
    counter.reset()
    assert counter.check(5) == (Verdict.GOOD, 0)
