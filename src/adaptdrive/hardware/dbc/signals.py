"""Flaws of a signal of a DBC, and what is probably one."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.hardware.link.layout import signal_bits


def signal_problem(message: Message, found: Sequence[Signal]) -> str | None:
    """Return why the signals of one name cannot be used, None where it is one that can."""
    signal = found[0]
    low, high, scale, offset = signal.minimum, signal.maximum, signal.scale, signal.offset
    if len(found) > 1:
        return f"is there {len(found)} times in message {message.name!r}: rename one"
    if signal.start < 0 or signal_bits(signal) >> 8 * message.length:
        return f"does not fit into the {message.length} bytes of message {message.name!r}"
    if not (scale and math.isfinite(scale) and math.isfinite(offset)):
        return f"has factor {scale:g} and offset {offset:g}"
    if low is not None and high is not None and low > high:
        return f"has the range [{low:g}|{high:g}], which ends below its start: state bus.ranges"
    return None


def sign_caution(signal: Signal) -> str | None:
    """Return that a range begins below what an unsigned signal can be, None where it does not.

    Args:
        signal: A signal without a problem.
    """
    low, high, scale = signal.minimum, signal.maximum, signal.scale
    if signal.is_signed or signal.is_float or low is None or high is None or not (low or high):
        return None
    first = min((end - signal.offset) / scale for end in (low, high))
    if not -math.inf < first <= -1.0:
        return None
    top = (1 << signal.length) - 1
    one, read = (raw * scale + signal.offset for raw in (-1, top))
    unit = f" {signal.unit}" if signal.unit else ""
    meant = f"has the range [{low:g}|{high:g}], and is unsigned: {one:g}{unit} would be read as"
    return f"{meant} {read:g}{unit}; is it signed (@1-, @0-) in the manual of the device?"
