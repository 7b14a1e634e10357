"""Waits before a lost bus is opened again."""

from adaptdrive.devices.bus import BusBackoff


def test_waits_double_up_to_two_seconds_and_start_anew_once_the_bus_was_of_use() -> None:
    heard = 3
    backoff = BusBackoff(lambda: heard)
    assert [backoff.next_s() for _ in range(7)] == [0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0]
    heard += 1
    assert [backoff.next_s() for _ in range(2)] == [0.1, 0.2]
