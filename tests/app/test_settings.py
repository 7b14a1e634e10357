"""What the controller is built from, as the configuration says it."""

from __future__ import annotations

import pytest

from adaptdrive.app.settings import controller_settings
from tests.config.documents import flaws, parse

HELD = {
    "voltage_loop__where": '"drive"',
    "signals__command__boost_reference_V__signal": '"DriveCommand.BoostReference"',
}


def test_the_drives_own_lag_enters_the_design() -> None:
    rates = controller_settings(parse(**HELD, voltage_loop__lag_s="0.5")).rates
    assert rates.lag_ticks == pytest.approx(60.0)


def test_without_a_lag_nine_ticks_are_counted() -> None:
    assert controller_settings(parse()).rates.lag_ticks == 9.0
    assert controller_settings(parse(**HELD)).rates.lag_ticks == 9.0


@pytest.mark.parametrize(
    "changes", [{"voltage_loop__lag_s": "0.1"}, {**HELD, "voltage_loop__lag_s": "1.1"}]
)
def test_a_lag_that_cannot_be_counted_is_a_flaw(changes: dict[str, str]) -> None:
    assert set(flaws(**changes)) == {"voltage_loop.lag_s"}
