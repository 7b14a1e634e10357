"""Two experiments on one drive at once."""

from __future__ import annotations

import os

import pytest

from adaptdrive.commission.run import alone
from adaptdrive.config.services import Mqtt
from adaptdrive.errors import CommissionError


def test_a_second_experiment_on_a_drive_is_refused() -> None:
    broker = Mqtt(host="bench.example")
    with (
        alone("commissioned", broker),
        alone("another", broker),
        alone("commissioned", Mqtt(host="elsewhere.example")),
        pytest.raises(CommissionError, match=rf"commissioned by process {os.getpid()}"),
        alone("commissioned", broker),
    ):
        pytest.fail("it began")
    with alone("commissioned", broker):
        pass
