"""Waits before a lost bus is opened again."""

from adaptdrive.hardware.backoff import BusBackoff


def test_waits_double_up_to_two_seconds_and_start_anew_once_the_bus_was_of_use() -> None:
    backoff = BusBackoff()
    assert [backoff.next_s() for _ in range(7)] == [0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0]
    backoff.reset()
    assert backoff.next_s() == 0.1
