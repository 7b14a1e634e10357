"""Checksums by their parameters agree with crccheck, and with frames that others have made."""

from __future__ import annotations

from typing import Any

import pytest
from crccheck.crc import ALLCRCCLASSES
from crccheck.crc import Crc as Reference
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config.bus import Crc, FrameIntegrity
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.can.database import SignalCatalogue
from adaptdrive.devices.can.integrity import FrameVerdict, crc_function
from tests.unit.devices.bench import odd_database

CHECK_INPUT = b"123456789"
WHOLE_BYTES = [
    one for one in ALLCRCCLASSES if one.width() >= 8 and one.reflect_input() == one.reflect_output()
]
CCITT_FALSE = {"poly": 0x1021, "init": 0xFFFF}
PROFILE_2 = {"poly": 0x2F, "init": 0xFF, "xorout": 0xFF}
ALIVE = ' SG_ Alive : 16|8@1+ (1,0) [0|255] "" X\n'
CRC_16 = ' SG_ Sum : 0|16@1+ (1,0) [0|65535] "" X\n' + ALIVE
CRC_8 = ' SG_ Alive : 8|4@1+ (1,0) [0|15] "" X\n SG_ Sum : 0|8@1+ (1,0) [0|255] "" X\n'


def form_of(*values: Any) -> Crc:
    """A form with a polynomial of any width, of which a configuration may have three."""
    names = ("poly", "init", "reflected", "xorout")
    given: dict[str, Any] = dict(zip(names, values, strict=True))
    return Crc.model_construct(**given)


def reference(form: Crc, width: int) -> Any:
    return Reference(width, form.poly, form.init, form.reflected, form.reflected, form.xorout)


@pytest.mark.parametrize("listed", WHOLE_BYTES, ids=lambda one: str(one.__name__))
def test_every_form_of_the_catalogue_has_its_check_value(listed: Any) -> None:
    form = form_of(
        listed.poly(),
        listed.initvalue(),
        listed.reflect_input(),
        listed.xor_output(),
    )
    assert crc_function(form, listed.width())(CHECK_INPUT) == listed.check_result()
    assert crc_function(form, listed.width())(bytes(range(256))) == listed.calc(bytes(range(256)))


@st.composite
def forms(draw: st.DrawFn) -> tuple[Crc, int]:
    width = draw(st.sampled_from([8, 16, 32]))
    words = st.integers(0, (1 << width) - 1)
    mirrored = st.booleans()
    return form_of(draw(words), draw(words), draw(mirrored), draw(words)), width


@given(forms(), st.binary(max_size=20), st.binary(max_size=64))
def test_any_form_agrees_with_crccheck(form: tuple[Crc, int], before: bytes, data: bytes) -> None:
    assert crc_function(*form, before)(data) == reference(*form).process(before + data).final()


def protected(signals: str, **crc: object) -> MessageCodec:
    return MessageCodec(odd_database(signals).get_message_by_name("Odd"), integrity(**crc))


def integrity(**crc: object) -> FrameIntegrity:
    return FrameIntegrity.model_validate({"counter": "Alive", "checksum": "Sum", "crc": crc})


def test_profile_5_of_autosar_is_described() -> None:
    # printed in the standard, for the data id 0x1234
    codec = protected(CRC_16, **CCITT_FALSE, after=[0x34, 0x12])
    frame = bytes.fromhex("1cca000000000000")
    assert codec.encode({}) == frame
    assert codec.decode(frame)[0] is FrameVerdict.GOOD


@pytest.mark.parametrize("frame", ["c401000000000000", "1902000000000000", "5203000000000000"])
def test_profile_2_of_autosar_is_described(frame: str) -> None:
    # made by the package autosar-e2e 1.0.0, with the data ids 0x10 to 0x1F
    codec = protected(CRC_8, **PROFILE_2, by_counter=list(range(0x10, 0x20)))
    assert codec.decode(bytes.fromhex(frame))[0] is FrameVerdict.GOOD


def test_a_checksum_in_motorola_order_is_read() -> None:
    signals = ' SG_ Sum : 55|16@0+ (1,0) [0|65535] "" X\n' + ALIVE
    frame = protected(signals, **CCITT_FALSE).encode({"Alive": 0})
    total = reference(form_of(0x1021, 0xFFFF, 0, 0), 16)
    assert frame[6:] == total.process(frame[:6]).final().to_bytes(2, "big")


@pytest.mark.parametrize(
    ("signals", "changes", "place", "words"),
    [
        (CRC_8, {"crc": CCITT_FALSE}, "crc.init", "more than the 8 bits"),
        (CRC_8, {"crc": None, "nibble": "Alive"}, "data_id", "need it"),
        (CRC_16, {"checksum": None}, "checksum", "is missing"),
        (CRC_8, {"counter": None, "crc": {**PROFILE_2, "by_counter": [1]}}, "counter", "missing"),
        (CRC_16, {"data_id": 0}, "data_id", "leave one out"),
    ],
)
def test_a_form_that_does_not_fit_is_a_flaw(
    signals: str, changes: dict[str, object], place: str, words: str
) -> None:
    given: dict[str, object] = {"counter": "Alive", "checksum": "Sum"}
    given["crc"] = PROFILE_2 if signals is CRC_8 else CCITT_FALSE
    catalogue = SignalCatalogue(odd_database(signals), fd=False)
    catalogue.check_integrity("Odd", FrameIntegrity.model_validate({**given, **changes}))
    found = {flaw.place: flaw.message for flaw in catalogue.flaws}
    assert words in found[f"bus.integrity.Odd.{place}"]
