"""Messages of a drive as the demonstration reads them."""

from __future__ import annotations

from datetime import UTC, datetime

import msgspec

from adaptdrive.control.reach import UNKNOWN, Reach
from adaptdrive.operation.messages import encode
from adaptdrive_sim.demo import heard
from tests.demo.stories import state


def test_a_state_whose_reach_is_not_known_is_read() -> None:
    """Any daemon may have left it on the broker; JSON has null for NaN."""
    for reach in (UNKNOWN, Reach(2.2, 4.4)):
        sent = encode(state(reach=reach, time=datetime(2026, 11, 22, tzinfo=UTC)))  # type: ignore[arg-type]
        assert msgspec.json.decode(sent, type=heard.StateMessage).setpoint == state().setpoint
