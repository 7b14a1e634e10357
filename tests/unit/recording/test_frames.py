"""Files of the log that are cut off or damaged: what is sound is read, and losses are named."""

from __future__ import annotations

import itertools
import random
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptdrive.recording.records import Kind, Record, framed, read_frames

SIZE = 200_000
STRIDES = [
    pytest.param(101, id="some"),
    pytest.param(1, id="every", marks=pytest.mark.proof),
]
"""Offsets that are tried: each of them takes the long form of these tests."""


def segment(seed: int = 1) -> list[Record]:
    """Records of 200 kB: of batches of ticks, and of events between them."""
    chance = random.Random(seed)
    records: list[Record] = []
    size = 0
    while size < SIZE:
        kind, length = (Kind.TICKS, 4_000) if chance.random() < 0.7 else (Kind.EVENT, 150)
        payload = chance.randbytes(chance.randrange(length))
        records.append(Record(len(records) + 1, 0.1 * len(records), 1.7e9, kind, payload))
        size += len(framed(records[-1]))
    return records


def places(records: Sequence[Record]) -> list[int]:
    """Where each frame begins, and where the last one ends."""
    return [0, *itertools.accumulate(len(framed(record)) for record in records)]


@pytest.mark.parametrize("stride", STRIDES)
def test_a_segment_that_is_cut_anywhere_gives_its_whole_records(stride: int) -> None:
    records = segment()
    content, edges = b"".join(map(framed, records)), places(records)
    whole = 0
    for end in range(0, len(content) + 1, stride):
        while whole + 1 < len(edges) and edges[whole + 1] <= end:
            whole += 1
        rest = [(edges[whole], end)] if end > edges[whole] else []
        assert list(read_frames(content[:end])) == records[:whole] + rest


@pytest.mark.parametrize("stride", STRIDES)
def test_a_byte_that_is_flipped_anywhere_costs_one_record_and_its_place_is_named(
    stride: int,
) -> None:
    records, chance = segment(), random.Random(2)
    content, edges = bytearray(b"".join(map(framed, records))), places(records)
    damaged = 0
    for place in range(0, len(content), stride):
        while edges[damaged + 1] <= place:
            damaged += 1
        flip = chance.randrange(1, 256)
        content[place] ^= flip
        loss = (edges[damaged], edges[damaged + 1])
        assert list(read_frames(bytes(content))) == [
            *records[:damaged],
            loss,
            *records[damaged + 1 :],
        ]
        content[place] ^= flip


@settings(deadline=None)
@given(noise=st.binary(max_size=2000))
def test_noise_gives_no_record(noise: bytes) -> None:
    assert list(read_frames(noise)) == ([(0, len(noise))] if noise else [])
