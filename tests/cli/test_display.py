"""What the command line says beside a refusal."""

from __future__ import annotations

import pytest

from adaptdrive.cli.display import refusal_advice


@pytest.mark.calculating
@pytest.mark.parametrize(
    ("reason", "advice"),
    [
        ("tripped (drive fault: word 0x3); reset first", "look the fault up"),
        ("cause is still there: stale: measurement is 1272 ms old, limit 50 ms", "check the part"),
        ("over-voltage: v_bst = 431 V, limit 430 V", "look for a load that feeds back"),
        ("setpoint = 5 V is outside 0…4.5 V", ""),
    ],
)
def test_a_refusal_for_a_trip_carries_its_remedy(reason: str, advice: str) -> None:
    found = refusal_advice(reason)
    assert found.startswith(advice)
    assert bool(found) is bool(advice)
