"""The contract of a simulated device: what it offers to do to its plant, and how it is asked."""

from __future__ import annotations

import msgspec

ROOT = "adaptdrive-sim"
TRUTH, DISTURB, REPLY = "truth", "disturb", "reply"


class Feature(msgspec.Struct, frozen=True):
    """A disturbance that the device offers to its operators.

    Attributes:
        text: What it does, in words.
        request: Payload of `disturb` without its id.
    """

    text: str
    request: dict[str, float]


class DeviceReply(msgspec.Struct, frozen=True):
    """The answer to one request.

    Attributes:
        id: Id of the request, None where none could be read.
        accepted: Whether it was carried out.
        reason: Why not; empty when it was.
    """

    id: str | None
    accepted: bool
    reason: str


def simulator_topic(drive: str, leaf: str) -> str:
    """Return a topic of a simulated device.

    Args:
        drive: Name of the drive.
        leaf: `truth`, `disturb` or `reply`.
    """
    return f"{ROOT}/{drive}/{leaf}"
