"""Damaged inputs: bytes changed, cut, doubled, moved, and values from the edges of their types."""

from __future__ import annotations

import random
from collections.abc import Sequence

EDGES = (
    *(b"nan", b"inf", b"-1e999", b"1e308", b"-0", b"0", b"9" * 40, b"null", b"true", b"[]", b"{}"),
    *(b"\x00", b"\xff\xff", b"\xed\xa0\x80", b"\xf0\x9f\x92\xa9", b'"', b"\\", b"\n", b"=", b"["),
)
LONGEST = 9000


def mutated(draw: random.Random, corpus: Sequence[bytes]) -> bytes:
    """Return a damaged copy of one of the inputs."""
    data = bytearray(draw.choice(corpus))
    for _ in range(draw.randint(1, 4)):
        place, length = draw.randint(0, len(data)), draw.choice([1, 1, 2, 4, 16, 200])
        match draw.randrange(5):
            case 0:
                data[place : place + length] = draw.randbytes(length)
            case 1:
                del data[place : place + length]
            case 2:
                data[place:place] = draw.choice(EDGES)
            case 3:
                other = draw.choice(corpus)
                start = draw.randint(0, len(other))
                data[place:place] = other[start : start + length]
            case _:
                data[place : place + length] = draw.choice(EDGES)
    return bytes(data[:LONGEST])
