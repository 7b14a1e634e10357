"""Frames that a port could not use, kept for reports: which, why, and how often."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from adaptdrive.hardware.link.codec import MessageCodec
from adaptdrive.hardware.link.integrity import FrameVerdict

_KINDS_HELD = 64
"""Kinds of refused frames remembered: a flood of ids must not fill the memory."""

_REMEDIES = {
    FrameVerdict.WRONG_LENGTH: "DLC {0}, needed {1}: the DBC describes another version "
    "of the message",
    FrameVerdict.WRONG_CHECKSUM: "compare [bus.integrity] with the drive's manual; look at the "
    "cable",
    FrameVerdict.COUNTER_STUCK: "its sender hangs, or a gateway repeats frames",
    FrameVerdict.COUNTER_LOST: "frames are lost: check the bus load and the cable",
    FrameVerdict.OUT_OF_RANGE: "{2}; a sensor of the drive is broken, or the DBC has another sign "
    "or range",
}


@dataclass(slots=True)
class _Refusal:
    """One kind: how often since the start and since the last good frame, and the last frame."""

    count: int = 0
    in_a_row: int = 0
    data: bytes = b""
    codec: MessageCodec | None = None


class Refusals:
    """Refused frames of each message, and frames that are not of this drive."""

    def __init__(self) -> None:
        self._seen: dict[str, dict[FrameVerdict | None, _Refusal]] = {}

    @property
    def any(self) -> bool:
        """True if a frame was refused since the start."""
        return bool(self._seen)

    def note(
        self,
        frame: str,
        verdict: FrameVerdict | None,
        data: bytes,
        codec: MessageCodec | None = None,
    ) -> None:
        """Remember a frame that failed a check, or of an id that nothing is taken from.

        Args:
            frame: Its message or id.
            verdict: The check, None for an id that nothing is taken from.
            data: Its bytes.
            codec: Codec of its message, None for such an id.
        """
        if verdict is None and frame not in self._seen and len(self._seen) >= _KINDS_HELD:
            return
        refusal = self._seen.setdefault(frame, {}).setdefault(verdict, _Refusal())
        refusal.count += 1
        refusal.in_a_row += 1
        refusal.data, refusal.codec = data, codec

    def accept(self, message: str) -> None:
        """Note a good frame of a message."""
        for refusal in self._seen.get(message, {}).values():
            refusal.in_a_row = 0

    def explain(self, message: str) -> str | None:
        """Return why a message has no good frame, None when none was refused since the last one."""
        found = self._seen.get(message, {})
        verdict = max(found, key=lambda one: found[one].in_a_row, default=None)
        if verdict is None or not found[verdict].in_a_row:
            return None
        count, remedy = found[verdict].in_a_row, _remedy(verdict, found[verdict])
        return f"its frames come and are refused ({verdict}, {count} in a row): {remedy}"

    def lines(self) -> Iterator[str]:
        """Every kind of refused frame, one line each."""
        for frame, found in self._seen.items():
            for verdict, refusal in found.items():
                shown = f"{refusal.count} x, last [{refusal.data.hex(' ')}]"
                if verdict is None:
                    why = f"no entry of [signals] is taken from this id, {shown}"
                else:
                    why = f"{verdict} {shown}: {_remedy(verdict, refusal)}"
                yield f"refused {frame}: {why}"


def _remedy(verdict: FrameVerdict, refusal: _Refusal) -> str:
    codec, data = refusal.codec, refusal.data
    needed = codec.required(data) if codec and verdict is FrameVerdict.WRONG_LENGTH else 0
    outside = codec.outside(data) if codec and verdict is FrameVerdict.OUT_OF_RANGE else ""
    return _REMEDIES[verdict].format(len(data), needed, outside or "its alive counter")
