"""Trips: each has a kind, and a text that names the values of its moment.

The kind leads to cause, remedy and page, which stand in `trips.toml`; the text is for people.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources


class TripKind(StrEnum):
    """Kind of a trip, as events, state, records and monitoring name it."""

    NO_MESSAGE = "no-message"
    MESSAGE_MISSING = "message-missing"
    FRAMES_REFUSED = "frames-refused"
    BUS_LOST = "bus-lost"
    NO_LINE_END = "no-line-end"
    NO_REPLY = "no-reply"
    GATEWAY = "gateway"
    REGISTERS_MISSING = "registers-missing"
    POLL_REFUSED = "poll-refused"
    VALUE_REFUSED = "value-refused"
    HEARTBEAT_STANDS = "heartbeat-stands"
    NO_MEASUREMENT = "no-measurement"
    SENSOR_MISSING = "sensor-missing"
    STALE = "stale"
    SENSOR_STALE = "sensor-stale"
    NOT_FINITE = "not-finite"
    OVERSLEPT = "overslept"
    DRIVE_FAULT = "drive-fault"
    EMERGENCY = "emergency"
    STATE_LEFT = "state-left"
    STATE_UNFIT = "state-unfit"
    NODE_RESTARTED = "node-restarted"
    HEARTBEAT_LOST = "heartbeat-lost"
    OBJECTS_WRITTEN = "objects-written"
    NOT_OPERATIONAL = "not-operational"
    NODE_LOST = "node-lost"
    OVER_VOLTAGE_PREDICTED = "over-voltage-predicted"
    VOLTAGE_FROZEN = "voltage-frozen"
    OVER_VOLTAGE = "over-voltage"
    ABOVE_LIMIT = "above-limit"
    PRECHARGE = "precharge"
    OUTPUT_HIGH = "output-high"
    OUTPUT_LOW = "output-low"
    MACHINE_BUSY = "machine-busy"
    RATE_UNKNOWN = "rate-unknown"
    FRAME_RATE = "frame-rate"
    COUNTER_STANDS = "counter-stands"
    REFUSED_SHARE = "refused-share"
    OUTPUT_FROZEN = "output-frozen"
    NOT_STOPPED = "not-stopped"
    STOP_NOT_TAKEN = "stop-not-taken"
    STOP_NOT_REPORTED = "stop-not-reported"
    SWITCHED_ON = "switched-on"
    WRITE_FUNCTION = "write-function"
    COMMAND_REFUSED = "command-refused"
    COMMAND_UNANSWERED = "command-unanswered"
    BUS_TAKES_NOTHING = "bus-takes-nothing"
    DRIVE_RESTARTED = "drive-restarted"
    DRIVE_STOPPED = "drive-stopped"
    OTHER_SENDER = "other-sender"
    OUTPUT_TOO_LOW = "output-too-low"
    OUTPUT_FELL = "output-fell"
    NO_RESPONSE = "no-response"
    NO_CURRENT = "no-current"
    CHARGE_TOO_LONG = "charge-too-long"
    LIMIT_CYCLE = "limit-cycle"
    OPERATOR_LOST = "operator-lost"
    SLOW_LOOP = "slow-loop"
    SECOND_CLIENT = "second-client"
    GAIN_NOT_FINITE = "gain-not-finite"
    COMMAND_UNFIT = "command-unfit"
    INTERNAL_ERROR = "internal-error"


@dataclass(frozen=True, slots=True)
class Trip:
    """One reason not to energise a drive.

    Attributes:
        kind: Its kind.
        text: What has happened, with the values of the moment.
    """

    kind: TripKind
    text: str

    def __str__(self) -> str:
        return self.text


def kind_of(word: str | None) -> TripKind | None:
    """Return the kind that a word names, None for none, or for one of another version."""
    return TripKind(word) if word and word in TripKind.__members__.values() else None


@dataclass(frozen=True, slots=True)
class Advice:
    """What a kind of trip means, and what ends it.

    Attributes:
        example: A text of such a trip; `…` stands for the rest.
        cause: The likeliest cause.
        remedy: Steps before `reset`.
        page: Page of the manual that says more.
    """

    example: str
    cause: str
    remedy: str
    page: str


def _advices() -> Mapping[TripKind, Advice]:
    file = resources.files("adaptdrive.safety") / "trips.toml"
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    return {TripKind(kind): Advice(**table) for kind, table in tables.items()}


ADVICES = _advices()
"""Advice for each kind of trip, as `trips.toml` gives it: read at the start, never at a trip."""


def remedy(kind: TripKind | None) -> str:
    """Return the steps that end a trip as plain text, empty where there is no trip.

    Args:
        kind: Kind of the trip.
    """
    return "" if kind is None else ADVICES[kind].remedy.replace("`", "")
