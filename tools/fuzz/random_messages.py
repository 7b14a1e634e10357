"""Messages of a DBC drawn at random: any place, length, sign, factor, byte order and page."""

from __future__ import annotations

import random

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion

_LENGTHS = (1, 2, 3, 4, 5, 6, 7, 8, 8, 8, 8, 12, 64)


def random_message(seed: int) -> Message:
    """Return a message whose signals fill a part of its bytes, none over another.

    Args:
        seed: Decides about everything.
    """
    draw = random.Random(seed)
    length = draw.choice(_LENGTHS)
    bits, place, signals = 8 * length, 0, []
    big, pages = draw.random() < 0.5, draw.random() < 0.3 and bits > 8
    if pages:
        signals.append(_signal(draw, "page", 0, 4, big=big, switches=True))
        place = 4
    while place < bits and len(signals) < 12:
        place += draw.choice([0, 0, 1, 3])
        size = min(draw.choice([1, 2, 4, 7, 8, 12, 16, 24, 32, 33, 64]), bits - place)
        if size > 0:
            page = draw.randrange(16) if pages else None
            signals.append(_signal(draw, f"s{len(signals)}", place, size, big=big, page=page))
        place += size
    return Message(100 + seed, f"Message{seed}", length, signals, is_fd=length > 8)


def _signal(
    draw: random.Random,
    name: str,
    place: int,
    size: int,
    *,
    big: bool,
    page: int | None = None,
    switches: bool = False,
) -> Signal:
    real = size in {32, 64} and not switches and draw.random() < 0.5
    scale = 1 if switches else draw.choice([1, 1, 0.1, -2.5, 1e-9, 1e30])
    limits = draw.choice([(None, None), (0, 0), (-10, 100)]) if not switches else (None, None)
    return Signal(
        name,
        8 * (place // 8) + 7 - place % 8 if big else place,
        size,
        byte_order="big_endian" if big else "little_endian",
        is_signed=not real and not switches and draw.random() < 0.5,
        conversion=BaseConversion.factory(scale=scale, offset=0, is_float=real),
        minimum=limits[0],
        maximum=limits[1],
        is_multiplexer=switches,
        multiplexer_ids=None if page is None else [page],
        multiplexer_signal=None if page is None else "page",
    )
