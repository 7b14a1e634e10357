"""Waiting times, and the clock of the kernel."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.operation.clock import BrokerBackoff, Synchronisation, kernel_synchronisation


def test_waiting_doubles_up_to_a_limit_and_starts_anew_after_a_good_connection() -> None:
    backoff = BrokerBackoff(lambda _, high: high, first_s=0.5, longest_s=30.0)
    assert [backoff.after(0.0) for _ in range(8)] == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]
    assert backoff.after(3.0) == 30.0  # a broker that hangs up at once is no good connection
    assert backoff.after(60.0) == 0.5


@given(st.integers(0, 10_000), st.floats(0.0, 1.0))
def test_waiting_is_spread_over_half_of_its_length(failures: int, chance: float) -> None:
    backoff = BrokerBackoff(lambda low, high: low + chance * (high - low), failures=failures)
    ceiling_s = min(30.0, 0.5 * 2.0 ** min(failures, 30))
    assert 0.5 * ceiling_s <= backoff.after(0.0) <= ceiling_s


def test_the_kernel_says_whether_its_clock_is_kept() -> None:
    assert kernel_synchronisation() in Synchronisation
