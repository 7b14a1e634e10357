"""Emergencies in words."""

from __future__ import annotations

import struct

import pytest
from canopen.emcy import EmcyError
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.devices.canopen.profile import parse_emergency


def frame(code: int, register: int = 0x01) -> bytes:
    return struct.pack("<HB5s", code, register, b"maker")


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFF))
def test_code_register_and_detail_are_read(code: int, register: int) -> None:
    emergency = parse_emergency(frame(code, register))
    assert emergency is not None
    assert (emergency.code, emergency.register, emergency.data) == (code, register, b"maker")
    assert emergency.over == (EmcyError(code, 0, b"", 0.0).get_desc() == "Error Reset / No Error")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x2310, "continuous over-current at the output"),
        (0x3299, "voltage"),
        (0x4FFF, "temperature"),
        (0x8130, "heartbeat of the daemon lost"),
        (0xFF01, "device specific"),
        (0xA000, "unknown"),
    ],
)
def test_it_is_told_in_words(code: int, words: str) -> None:
    text = str(parse_emergency(frame(code, 0x21)))
    assert text == f"emergency 0x{code:04X}, {words} (error register 0x21)"


@pytest.mark.parametrize(("length", "register"), [(2, ""), (3, " (error register 0x01)")])
def test_a_short_frame_has_what_it_carries(length: int, register: str) -> None:
    text = str(parse_emergency(frame(0x2310)[:length]))
    assert text == f"emergency 0x2310, continuous over-current at the output{register}"


@pytest.mark.parametrize("length", [0, 1])
def test_a_frame_without_a_whole_code_is_none(length: int) -> None:
    assert parse_emergency(bytes(length)) is None
