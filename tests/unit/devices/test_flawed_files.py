"""A maker's file works unchanged: a flaw is an error only for who uses what it concerns."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import can
import cantools
import pytest

from adaptdrive.config.bus import CanBus
from adaptdrive.config.section import Range
from adaptdrive.devices.can.database import SignalCatalogue, describe, read_dbc
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.devices.canopen.dictionary import ObjectCatalogue, read_eds
from adaptdrive.util.errors import ConfigurationError
from tests.unit.devices.bench import EXAMPLES, MOTOR, TIMING, motor_bus, rewritten

HEAD = 'VERSION ""\nBU_: A\n'
SOUND = 'BO_ 256 Sound: 8 A\n SG_ Level : 0|16@1+ (0.1,0) [0|0.0] "V" A\n'
FLAWS = {
    "overlap": ' SG_ Other : 8|16@1+ (1,0) [0|0] "" A\n',
    "twice": ' SG_ Far : 32|16@1+ (1,0) [0|0] "" A\n SG_ Far : 48|16@1+ (1,0) [0|0] "" A\n',
    "beyond": ' SG_ Far : 60|8@1+ (1,0) [0|0] "" A\n',
    "beyond, big": ' SG_ Far : 60|8@0+ (1,0) [0|0] "" A\n',
    "digit": ' SG_ 5V_RAIL : 16|8@1+ (1,0) [0|0] "" A\n',
    "table in two lines": 'VAL_ 256 Gone 0 "off"\n 1 "on" ;\n',
    "long id": 'BO_ 123456789 Long: 8 A\n SG_ Far : 0|8@1+ (1,0) [0|0] "" A\n',
    "no id": 'BO_ 1073741825 Nowhere: 8 A\n SG_ Far : 0|8@1+ (1,0) [0|0] "" A\n',
    "digit of a message": 'BO_ 257 2017_X: 8 A\n SG_ Far : 0|8@1+ (1,0) [0|0] "" A\n',
    "spoilt": 'BO_ 258 Spoilt: 8 A\n SG_ Far @ 0|8 "" A\nBO_ 259 Next: 8 A\n',
    "spoilt message": 'BO_ 258 Spoilt 8\n SG_ Far : 0|8@1+ (1,0) [0|0] "" A\nBO_ 259 Next: 8 A\n',
    "names of nothing": 'VAL_ 256 Gone 0 "Off" 1 "On" ;\n',
}


def written(folder: Path, text: str) -> Path:
    path = folder / "flawed.dbc"
    path.write_text(HEAD + text)
    return path


def test_a_number_that_nobody_could_write_out_is_refused_with_its_line(tmp_path: Path) -> None:
    path = written(tmp_path, SOUND + 'BA_DEF_ SG_ "Start" INT 0 -1e999100;\n')
    with pytest.raises(ConfigurationError, match="line 5: -1e999100 is too large a number"):
        read_dbc(path)


@pytest.mark.parametrize("flaw", FLAWS)
def test_a_flaw_of_a_dbc_is_a_remark_with_its_line(tmp_path: Path, flaw: str) -> None:
    database, remarks = read_dbc(written(tmp_path, SOUND + FLAWS[flaw]))
    remark, *others = remarks
    assert others == []
    line = (HEAD + SOUND).count("\n") + 1 + (flaw in {"spoilt", "twice"})
    assert remark.startswith(f"line {line}: ")
    level = database.get_message_by_name("Sound").get_signal_by_name("Level")
    expected = cantools.database.load_string(HEAD + SOUND, database_format="dbc")
    (other,) = expected.get_message_by_name("Sound").signals  # type: ignore[union-attr]
    assert (level.start, level.length, level.scale) == (other.start, other.length, other.scale)
    assert SignalCatalogue(database, remarks, fd=False).find("Sound.Level", "signals.output")


@pytest.mark.parametrize(
    "text",
    [
        'CM_ SG_ 256 "no name";\n',
        "BS_: 500000 : 1,2\n",
        'CM_ "a;\nb"\n',
        'BA_DEF_ BO_  "Colour" STRING ;\nBA_ "Colour" BO_ 256 "#57e389";\n',
    ],
)
def test_what_nobody_reads_may_be_spoilt(tmp_path: Path, text: str) -> None:
    assert read_dbc(written(tmp_path, text + SOUND))[1] == []


@pytest.mark.parametrize(
    ("flaw", "named", "words"),
    [
        ("beyond", "Sound.Far", "signal 'Far' does not fit into the 8 bytes of message 'Sound'"),
        ("beyond, big", "Sound.Far", "signal 'Far' does not fit into the 8 bytes"),
        ("twice", "Sound.Far", "signal 'Far' is there 2 times in message 'Sound'"),
        ("spoilt", "Spoilt.Far", "line 6: 'SG_ Far @ 0|8"),
        ("no id", "Nowhere.Far", "no frame has the id 0x40000001"),
    ],
)
def test_a_flaw_is_an_error_for_who_uses_it(
    tmp_path: Path, flaw: str, named: str, words: str
) -> None:
    catalogue = SignalCatalogue(*read_dbc(written(tmp_path, SOUND + FLAWS[flaw])), fd=False)
    catalogue.find(named, "signals.output")
    (problem,) = catalogue.flaws
    assert problem.place == "signals.output"
    assert words in problem.message


def test_a_name_that_begins_with_a_digit_is_used_as_it_stands(tmp_path: Path) -> None:
    text = SOUND + FLAWS["digit"] + 'VAL_ 256 5V_RAIL 1 "On" ;\n'
    catalogue = SignalCatalogue(*read_dbc(written(tmp_path, text)), fd=False)
    found = catalogue.find("Sound.5V_RAIL", "signals.bridge")
    assert found is not None
    assert catalogue.field(found, "state").names == {1: "On"}


def test_names_of_values_may_continue_in_the_next_lines(tmp_path: Path) -> None:
    text = SOUND + 'VAL_ 256 Level 0 "Off" \n 1 "On" -2\n"Back" \n;\n' + FLAWS["names of nothing"]
    database, remarks = read_dbc(written(tmp_path, text))
    catalogue = SignalCatalogue(database, remarks, fd=False)
    found = catalogue.find("Sound.Level", "signals.bridge")
    assert found is not None
    assert catalogue.field(found, "state").names == {0: "Off", 1: "On", -2: "Back"}
    (remark,) = remarks
    assert remark.startswith("line 9: ")


def test_an_id_of_29_bits_without_its_mark_is_one_of_29_bits(tmp_path: Path) -> None:
    text = FLAWS["long id"] + 'VAL_ 123456789 Far 1 "On" ;\n'
    (message,) = read_dbc(written(tmp_path, text))[0].messages
    assert (message.frame_id, message.is_extended_frame) == (123456789, True)
    choices = message.get_signal_by_name("Far").choices
    assert choices is not None
    assert choices[1] == "On"


def test_one_name_for_two_ids_is_an_error_for_who_uses_it(tmp_path: Path) -> None:
    text = SOUND + SOUND.replace("256", "257")
    catalogue = SignalCatalogue(*read_dbc(written(tmp_path, text)), fd=False)
    catalogue.find("Sound.Level", "signals.output")
    assert "'Sound' is the name of 0x100 and 0x101" in catalogue.flaws[0].message


def test_no_line_of_a_parser_reaches_the_log(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG):
        read_dbc(written(tmp_path, SOUND + SOUND + "".join(FLAWS.values())))
    assert [one for one in caplog.records if one.name.startswith("cantools")] == []


def test_two_values_that_are_sent_must_not_share_bits(tmp_path: Path) -> None:
    bus = rewritten(tmp_path, (" BridgeEnable : 32|", " BridgeEnable : 31|"))
    with pytest.raises(ConfigurationError, match="'BridgeEnable' and 'BoostReference' share bits"):
        map_drive(bus, MOTOR.signals, TIMING)


def test_messages_come_from_several_files(tmp_path: Path) -> None:
    text = (EXAMPLES / "adaptdrive.dbc").read_text()
    head, start = text[: text.index("BO_ ")], text.index("BO_ 257")
    end = text.index("\nBO_ ", start) if "\nBO_ " in text[start:] else text.index("\n\n", start)
    (tmp_path / "load.dbc").write_text(f"{head}{text[start:end]}\n")
    (tmp_path / "rest.dbc").write_text(text[:start] + text[end:])
    bus = motor_bus(database=[tmp_path / "rest.dbc", tmp_path / "load.dbc"])
    whole = map_drive(bus, MOTOR.signals, TIMING)
    assert {one.codec.name for one in whole.statuses} == {"DriveStatus", "DriveLoad"}
    with pytest.raises(ConfigurationError, match="no message 'DriveLoad'"):
        map_drive(motor_bus(database=[tmp_path / "rest.dbc"]), MOTOR.signals, TIMING)


def test_a_stated_range_stands_in_place_of_a_wrong_one(tmp_path: Path) -> None:
    text = (EXAMPLES / "adaptdrive.dbc").read_text()
    place = text.index(" BoostReference : ")
    line = text[place : text.index("\n", place)]
    spoilt = line[: line.index("[")] + '[32768|32767] "V"' + line.split('"')[2]
    bus = rewritten(tmp_path, (line, spoilt))
    with pytest.raises(ConfigurationError, match="ends below its start: state bus"):
        map_drive(bus, MOTOR.signals, TIMING)
    name = "DriveCommand.BoostReference"
    stated = bus.model_copy(update={"ranges": {name: Range(low=0.0, high=600.0)}})
    (order,) = map_drive(stated, MOTOR.signals, TIMING).orders
    assert order.codec.encode({"BoostReference": 600.0})
    with pytest.raises(ValueError, match="outside 0…600"):
        order.codec.encode({"BoostReference": 600.1})
    wrong = bus.model_copy(update={"ranges": {f"{name}s": Range(low=0.0, high=1.0)}})
    with pytest.raises(ConfigurationError, match=f"did you mean '{name}'"):
        map_drive(wrong, MOTOR.signals, TIMING)


J1939 = (
    f"BO_ {(1 << 31) | 0x18FF50E5} Charger: 8 A\n"
    ' SG_ Level : 0|16@1+ (0.1,0) [0|0] "V" A\n'
    'BO_ 256 Short: 8 A\n SG_ Level : 0|16@1+ (0.1,0) [0|0] "V" A\n'
)


def addressed(path: Path, **frames: dict[str, int]) -> CanBus:
    return motor_bus(database=[path]).model_validate(
        {
            "type": "can",
            "interface": "virtual",
            "channel": "c",
            "database": path,
            "clock": "Charger",
            "frames": frames,
        }
    )


def test_source_and_priority_of_a_j1939_message_are_data(tmp_path: Path) -> None:
    path = written(tmp_path, J1939)
    bus = addressed(path, Charger={"source": 0x21, "priority": 3})
    message = describe(bus)[0].get_message_by_name("Charger")
    frame = can.Message(arbitration_id=message.frame_id, is_extended_id=True)
    assert frame.arbitration_id == 0x0CFF5021
    for name, words in (("Short", "11 bits"), ("Chargr", "did you mean 'Charger'")):
        with pytest.raises(ConfigurationError, match=words):
            describe(addressed(path, **{name: {"source": 1}}))


EDS_HEAD = "[DeviceInfo]\nVendorNumber=0x1\nProductNumber=\n"
LEVEL = "[2000]\nParameterName=Level\nDataType=0x0006\nAccessType=ro\nPDOMapping=1\n"
EDS_FLAWS = {
    "[2001sub1]\nParameterName=A\nDataType=6\nAccessType=ro\n": "[2001sub1] is left out",
    "[2001]\nParameterName=A\nObjectType=7\nAccessType=ro\n": "it has no DataType",
    "[2001]\nParameterName=A\nDataType=zzz\nAccessType=ro\n": "it has DataType = 'zzz'",
    LEVEL: "[2000] is left out: it is there twice",
    "= = =\n": "'= = =' is no entry",
}


def eds(folder: Path, text: str) -> Path:
    path = folder / "flawed.eds"
    path.write_text(EDS_HEAD + LEVEL + text)
    return path


@pytest.mark.parametrize("flaw", EDS_FLAWS)
def test_a_flaw_of_an_eds_is_a_remark_with_its_line(tmp_path: Path, flaw: str) -> None:
    catalogue = ObjectCatalogue(*read_eds(eds(tmp_path, flaw), 5))
    (caution,) = catalogue.cautions
    assert caution.message.startswith(f"line {(EDS_HEAD + LEVEL).count(chr(10)) + 1}: ")
    assert EDS_FLAWS[flaw] in caution.message
    assert catalogue.find("0x2000", "signals.output") is not None
    assert catalogue.flaws == []
    if "2001" in flaw:
        named = "0x2001.1" if "sub" in flaw else "0x2001"
        assert catalogue.find(named, "signals.output") is None
        assert EDS_FLAWS[flaw] in catalogue.flaws[0].message


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ("LowLimit=0\nHighLimit=0x00\n", (0, 65535)),
        ("LowLimit=\nHighLimit=\n", (0, 65535)),
        ("LowLimit=010\nHighLimit=0144\n", (8, 100)),
        ("LowLimit=08\nHighLimit=+9\n", (8, 9)),
        ("LowLimit=low\nHighLimit=9\n", (0, 9)),
    ],
)
def test_numbers_of_an_eds_in_any_spelling(
    tmp_path: Path, limits: str, expected: tuple[int, int]
) -> None:
    text = f"[2001]\nObjectType=\nDataType=06\nAccessType=ro\nPDOMapping=1\n{limits}"
    catalogue = ObjectCatalogue(*read_eds(eds(tmp_path, text), 5))
    entry = catalogue.find("0x2001", "signals.output")
    assert entry is not None
    assert entry.coding.name == "0x2001"
    assert (entry.coding.low, entry.coding.high) == expected


@pytest.mark.parametrize("case", [str.lower, str.upper, str.swapcase])
def test_sections_and_keys_of_an_eds_in_any_case(
    tmp_path: Path, case: Callable[[str], str]
) -> None:
    text = (EXAMPLES / "cia402.eds").read_text()
    path = tmp_path / "any.eds"
    lines = text.splitlines()
    heads = [case(one) if one[:1] == "[" else one.partition("=") for one in lines]
    path.write_text(
        "\n".join(one if isinstance(one, str) else case(one[0]) + "".join(one[1:]) for one in heads)
    )
    plain, other = (ObjectCatalogue(*read_eds(one, 5)) for one in (EXAMPLES / "cia402.eds", path))
    assert [one.index for one in other.variables()] == [one.index for one in plain.variables()]
    assert [one.data_type for one in other.variables()] == [
        one.data_type for one in plain.variables()
    ]
    assert (other.identity, other.cautions) == (plain.identity, plain.cautions)


def test_a_file_without_objects_is_no_eds(tmp_path: Path) -> None:
    path = tmp_path / "empty.eds"
    path.write_text("nothing\n")
    with pytest.raises(ConfigurationError, match="it describes no object"):
        read_eds(path, 5)
