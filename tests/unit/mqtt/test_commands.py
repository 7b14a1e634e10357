"""Reading commands: whatever comes in, a request or a reason goes out."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.mqtt.commands import Payload
from adaptdrive.mqtt.contract import Reply, encode
from adaptdrive.runtime.requests import REQUESTS, SetSetpoint
from adaptdrive.util.errors import RefusedError

scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
keys = st.sampled_from(["id", "value", "expires", "shape", "low", "high", "period_s"])
documents = st.recursive(
    scalars, lambda some: st.lists(some) | st.dictionaries(keys | st.text(), some)
)
anything = st.binary() | documents.map(lambda document: json.dumps(document).encode())


@given(st.sampled_from(tuple(REQUESTS)), anything)
def test_an_id_that_is_read_can_be_sent_back(verb: str, raw: bytes) -> None:
    payload = Payload(raw)
    if payload.id is not None:
        sent = encode(Reply(payload.id, verb, accepted=False, reason="", state=None))
        assert msgspec.json.decode(sent, type=Reply).id == payload.id


@given(st.floats())
def test_only_finite_numbers_become_set_points(value: float) -> None:
    raw = json.dumps({"id": "a", "value": value}).encode()
    if math.isfinite(value):
        assert Payload(raw).request("setpoint") == (SetSetpoint(value), None)
    else:
        with pytest.raises(RefusedError, match="not a finite number"):
            Payload(raw).request("setpoint")


@given(st.text(st.characters(categories=["L", "N", "P"]), min_size=1), st.integers(1, 40))
def test_the_id_of_a_torn_command_is_found(identity: str, lost: int) -> None:
    whole = json.dumps({"id": identity, "value": {"shape": "square", "low": 1.0, "high": 2.0}})
    payload = Payload(whole[:-lost].encode())
    assert payload.id == identity
    with pytest.raises(RefusedError, match="not JSON"):
        payload.request("waveform")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-03-01T12:00:00Z", datetime(2026, 3, 1, 12, tzinfo=UTC)),
        ("2026-03-01T14:00:00+02:00", datetime(2026, 3, 1, 12, tzinfo=UTC)),
        ("2026-03-01T12:00:00.25Z", datetime(2026, 3, 1, 12, 0, 0, 250_000, tzinfo=UTC)),
    ],
)
def test_expires_is_any_rfc_3339_time(text: str, expected: datetime) -> None:
    raw = json.dumps({"id": "a", "expires": text}).encode()
    _, expires = Payload(raw).request("enable")
    assert expires == expected
