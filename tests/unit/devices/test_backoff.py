"""Waits before a lost bus is opened again."""

from itertools import islice

from adaptdrive.devices.bus import backoff_s


def test_waits_double_up_to_two_seconds_and_start_anew_once_the_bus_was_of_use() -> None:
    received = 3
    delays_s = backoff_s(lambda: received)
    assert [*islice(delays_s, 7)] == [0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0]
    received += 1
    assert [*islice(delays_s, 2)] == [0.1, 0.2]
