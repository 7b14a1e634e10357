"""Whatever a configuration or its DBC, EDS or register map holds, `check` ends with clear lines."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adaptdrive.app.examine import load_examined
from adaptdrive.cli import main
from adaptdrive.config.drive import BROKER_USERS
from adaptdrive.errors import ConfigurationError

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
TOMLS = sorted(path.name for path in EXAMPLES.glob("*.toml"))
PATIENCE_MS = 60_000
FUZZ = settings(
    max_examples=60,
    deadline=PATIENCE_MS,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

VALUES = st.one_of(
    st.integers(-(2**70), 2**70).map(str),
    st.floats().map(lambda value: repr(value).replace("e+", "e")),
    st.sampled_from(["true", '""', '"x"', '"/dev/zero"', '"a\\u0000b"', "[]", "[1]", "{}"]),
    st.sampled_from(['"\\u001b[2J\\n"', "2026-11-21", "1e-300", "1e300", "40001", '"A.B"', "-1"]),
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for path in EXAMPLES.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path


def checked(path: Path) -> list[str]:
    """Return the lines of `adaptdrive check`, which exits with 2 for flaws and 0 for warnings."""
    complaints = io.StringIO()
    with contextlib.redirect_stderr(complaints), contextlib.redirect_stdout(io.StringIO()):
        status = main(["check", str(path)])
    lines = complaints.getvalue().splitlines()
    warning = f"adaptdrive: {path}: warning: "
    assert status == (0 if all(line.startswith(warning) for line in lines) else 2)
    for line in lines:
        assert line.startswith("adaptdrive: ")
        assert line.isprintable()
    return lines


def assigned(text: str) -> list[int]:
    """Lines that give a key a value."""
    return [at for at, line in enumerate(text.splitlines()) if re.match(r'[\w".]+ = ', line)]


@st.composite
def changed_keys(draw: st.DrawFn, name: str) -> str:
    """An example with other values, and keys that are missing or called differently."""
    lines = (EXAMPLES / name).read_text(encoding="utf-8").splitlines()
    places = assigned("\n".join(lines))
    for at in draw(st.lists(st.sampled_from(places), min_size=1, max_size=5)):
        key, _, value = lines[at].partition(" = ")
        kind = draw(st.sampled_from(["value", "key", "gone"]))
        if kind == "value":
            lines[at] = f"{key} = {draw(VALUES)}"
        elif kind == "key":
            lines[at] = f"{key}{draw(st.sampled_from(['x', '_s', '2']))} = {value}"
        else:
            lines[at] = ""
    return "\n".join(lines)


@st.composite
def spoilt(draw: st.DrawFn, text: str) -> str:
    """A text with some characters put in, taken out or replaced."""
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, len(text) - 1))
        end = min(len(text), at + draw(st.sampled_from([0, 1, 1, 2, 20, 300])))
        put = draw(st.one_of(st.text(max_size=4), st.sampled_from(["0", "-", "1e999", "nan", "|"])))
        text = text[:at] + put + text[end:]
    return text


def test_a_register_that_a_sensor_misses_is_named_beside_a_flaw_elsewhere(folder: Path) -> None:
    path = folder / "bath-thermocouples.toml"
    text = path.read_text(encoding="utf-8")
    assert "\nchannel_1 = " in text
    text = text.replace("\nchannel_1 = ", "\nchannel_3 = ").replace("\nrule = ", "\nrulex = ")
    path.write_text(text, encoding="utf-8")
    complaints = "\n".join(checked(path))
    assert "rulex" in complaints
    assert "[sensor_bus.registers] has no register 'channel_1'" in complaints


@FUZZ
@given(data=st.data(), name=st.sampled_from(TOMLS))
def test_changed_keys_never_end_in_a_traceback(
    folder: Path, data: st.DataObject, name: str
) -> None:
    (folder / name).write_text(data.draw(changed_keys(name)), encoding="utf-8")
    checked(folder / name)


@FUZZ
@given(data=st.data(), name=st.sampled_from(TOMLS))
def test_spoilt_files_never_end_in_a_traceback(
    folder: Path, data: st.DataObject, name: str
) -> None:
    text = data.draw(spoilt((EXAMPLES / name).read_text(encoding="utf-8")))
    (folder / name).write_text(text, encoding="utf-8")
    checked(folder / name)


@FUZZ
@given(
    data=st.data(),
    pair=st.sampled_from(
        [
            ("motor.toml", "adaptdrive.dbc"),
            ("motor-inverter.toml", "inverter.dbc"),
            ("motor-cia402.toml", "cia402.eds"),
        ]
    ),
)
def test_spoilt_descriptions_never_end_in_a_traceback(
    folder: Path, data: st.DataObject, pair: tuple[str, str]
) -> None:
    configuration, description = pair
    text = data.draw(spoilt((EXAMPLES / description).read_text(encoding="cp1252")))
    (folder / description).write_bytes(text.encode("cp1252", "replace"))
    shutil.copy(EXAMPLES / configuration, folder)
    checked(folder / configuration)


def flaws(folder: Path, name: str, *changes: tuple[str, str]) -> dict[str, str]:
    """Flaws of an example in which texts are replaced, by place."""
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / name).write_text(text, encoding="utf-8")
    try:
        load_examined(folder / name)
    except ConfigurationError as error:
        return {flaw.place: flaw.message for flaw in error.flaws}
    return {}


def test_flaws_of_file_and_dbc_are_listed_together(folder: Path) -> None:
    found = flaws(
        folder,
        "motor.toml",
        ("period_s = 1.0", "period_s = nan"),
        ("udp_port = 43113", "udp_port = 0"),
        ("precharge_timeout_s", "precharge_time_s"),
        ("output_max = 5.0", "output_max = 1.0"),
        ("DriveLoad.Tachometer", "DriveLoad.Tacho"),
        ('checksum = "CommandCrc"', 'checksum = "Crc"'),
    )
    assert set(found) == {
        "load.period_s",
        "bus.udp_port",
        "interlocks.output_max",
        "interlocks.precharge_time_s",
        "signals.output",
        "bus.integrity.DriveCommand.checksum",
    }
    assert "did you mean 'precharge_timeout_s'?" in found["interlocks.precharge_time_s"]


def test_flaws_of_file_and_register_map_are_listed_together(folder: Path) -> None:
    found = flaws(
        folder,
        "motor-modbus-tcp.toml",
        ("reference_max = 4.5", 'reference_max = "much"'),
        ("address = 2,", "address = 40003,"),
        ('boost_voltage_V = "boost_voltage"', 'boost_voltage_V = "boost_voltag"'),
    )
    assert set(found) == {
        "load.reference_max",
        "signals.boost_voltage_V.signal",
        "bus.registers.host_alive.address",
    }


def test_a_key_of_another_section_is_proposed(folder: Path) -> None:
    found = flaws(folder, "motor.toml", ("feed_forward = true", "stale_s = 0.1"))
    assert found["voltage_loop.stale_s"] == "Unknown key (did you mean interlocks.stale_s?)"


@pytest.mark.parametrize("factor", ["0", "nan", "inf"])
def test_a_dbc_factor_that_gives_no_value_is_a_flaw(folder: Path, factor: str) -> None:
    dbc = (EXAMPLES / "adaptdrive.dbc").read_text()
    changed, count = re.subn(r"(BoostVoltage : [^(]*)\([^,]*,", rf"\1({factor},", dbc)
    assert count == 1
    (folder / "adaptdrive.dbc").write_text(changed)
    found = flaws(folder, "motor.toml")
    assert set(found) & {"signals.boost_voltage_V", "bus.database"}


@pytest.fixture
def pipe(folder: Path) -> Path:
    path = folder / "adaptdrive.dbc"
    path.unlink()
    os.mkfifo(path)
    return path


def test_a_pipe_as_dbc_is_not_waited_for(folder: Path, pipe: Path) -> None:
    assert str(pipe) in flaws(folder, "motor.toml")["bus.database"]


@pytest.mark.parametrize(
    "name", ["operator", "viewer", "Operator", "-rf", "a/b", "+", "#", "..", ""]
)
def test_a_drive_has_a_name_that_is_safe_everywhere(folder: Path, name: str) -> None:
    assert set(flaws(folder, "motor.toml", ('name = "motor"', f'name = "{name}"'))) == {
        "drive.name"
    }


def test_the_names_of_people_are_those_of_the_broker() -> None:
    acl = (EXAMPLES.parent / "mosquitto" / "adaptdrive.acl").read_text()
    assert set(re.findall(r"^user (\w+)$", acl, re.MULTILINE)) == set(BROKER_USERS)


@pytest.mark.parametrize(
    ("name", "change", "place", "words"),
    [
        ("motor.toml", ("_max_V = 400.0", "_max_V = 601.0"), "boost_reference_V", "0…600"),
        ("motor.toml", ("max_S = 0.15 ", "max_S = 0.9 "), "current_scale_S", "cannot carry 0.9"),
        ("bath-modbus-tcp.toml", ("_max_V = 400.0", "_max_V = 601.0"), "boost_reference_V", "601"),
    ],
)
def test_a_command_that_cannot_carry_its_limits_is_a_flaw(
    folder: Path, name: str, change: tuple[str, str], place: str, words: str
) -> None:
    over = ("boost_voltage_max_V = 430.0", "boost_voltage_max_V = 630.0")
    room = ("high = 600.0 } }      # 40017", "high = 655.0 } }")
    found = flaws(folder, name, change, over, *([room] if "modbus" in name else []))
    assert set(found) == {f"signals.command.{place}"}
    assert words in found[f"signals.command.{place}"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ('"INV_STATE.N_ACT"', "the signal is in rpm, the quantity in V: name another signal"),
        ('{ signal = "INV_STATE.N_ACT", unit = "rpm" }', "leads to rad/s, the quantity is in V"),
        ('{ signal = "INV_STATE.N_ACT", scale = 2.0, unit = "degC" }', "leads to K"),
        ('{ signal = "INV_STATE.N_ACT", scale = 2.0, unit = "mV" }', ""),
        ('{ signal = "INV_STATE.N_ACT", scale = 2.0 }', ""),
    ],
)
def test_a_dbc_unit_of_another_quantity_is_a_flaw(folder: Path, given: str, words: str) -> None:
    old = '{ signal = "INV_STATE.N_ACT", scale = 2.1502e-3 }'
    found = flaws(folder, "motor-inverter.toml", (old, given))
    assert set(found) == ({"signals.output"} if words else set())
    assert words in found.get("signals.output", "")


@pytest.mark.parametrize(
    ("name", "refused_s", "accepted_s", "words"),
    [
        ("motor.toml", 0.012, 0.0125, "0.0125 s, 1.5 times bus.clock_ticks = 1 (8.333 ms)"),
        ("motor-inverter.toml", 0.037, 0.0375, "0.0375 s, 1.5 times bus.clock_ticks = 3 (25 ms)"),
        ("motor-cia402.toml", 0.005, 0.0125, "0.0125 s, 1.5 times a half cycle"),
    ],
)
def test_a_measurement_may_be_as_old_as_the_next_one_makes_it(
    folder: Path, name: str, refused_s: float, accepted_s: float, words: str
) -> None:
    (line,) = re.findall(r"(?m)^stale_s = [\d.]+", (folder / name).read_text())
    found = flaws(folder, name, (line, f"stale_s = {refused_s}"))
    assert words in found["interlocks.stale_s"]
    assert "interlocks.stale_s" not in flaws(folder, name, (line, f"stale_s = {accepted_s}"))


@pytest.mark.parametrize(
    ("name", "refused", "words"),
    [
        ("motor.toml", "0.012", "0.0125 s, 1.5 times bus.clock_ticks = 1 (8.333 ms)"),
        ("motor-inverter.toml", "0.037", "0.0375 s, 1.5 times bus.clock_ticks = 3 (25 ms)"),
        ("motor-modbus-tcp.toml", "0.149", "0.15 s, 1.5 times one poll of bus.poll_ticks = 12"),
        ("motor.toml", "0.009", "(it is 0.009)"),
        ("motor.toml", "61", "(it is 61)"),
        ("motor-modbus-rtu.toml", "inf", "(it is inf)"),
        ("motor-modbus-rtu.toml", '"0.4 s"', "(it is '0.4 s')"),
    ],
)
def test_a_time_out_that_no_drive_can_have_is_a_flaw(
    folder: Path, name: str, refused: str, words: str
) -> None:
    (line,) = re.findall(r"(?m)^command_timeout_s = [\d.]+", (folder / name).read_text())
    found = flaws(folder, name, (line, f"command_timeout_s = {refused}"))
    assert set(found) == {"bus.command_timeout_s"}
    assert words in found["bus.command_timeout_s"]


def test_a_drive_that_watches_heartbeats_has_no_time_out_of_commands(folder: Path) -> None:
    stated = ('sync = "daemon"', 'command_timeout_s = 0.1\nsync = "daemon"')
    assert "Unknown key" in flaws(folder, "motor-cia402.toml", stated)["bus.command_timeout_s"]


OUTPUTS = {
    "motor-inverter.toml": ('{ signal = "INV_STATE.N_ACT", scale = 2.1502e-3 }', "INV_STATE.N_ACT"),
    "motor-modbus-tcp.toml": ('"tachometer"', "tachometer"),
    "motor-cia402.toml": ('{ signal = "0x2001.2", scale = 1.0e-6 }', "0x2001.2"),
}


@pytest.mark.parametrize("name", OUTPUTS)
@pytest.mark.parametrize(
    ("stated", "labelled", "words"),
    [
        ("rpm", "rpm", "unit = 'rpm' leads to rad/s, the quantity is in rpm"),
        ("rpm", "Hz", "load.output_unit = 'rad/s'"),
        ("mA", "mA", "unit = 'mA' leads to A, the quantity is in mA"),
        ("degC", "°C", "unit = 'degC' leads to K, the quantity is in degC"),
        ("rpm", "%", "unit = 'rpm' leads to rad/s, the quantity is in %"),
        ("rpm", "rad/s", ""),
        ("degC", "K", ""),
        ("rpm", "of the shaft", ""),
    ],
)
def test_an_output_that_is_converted_is_labelled_with_its_si_unit(
    folder: Path, name: str, stated: str, labelled: str, words: str
) -> None:
    old, signal = OUTPUTS[name]
    source = f'{{ signal = "{signal}", scale = 2.0, unit = "{stated}" }}'
    changes = [(f"output = {old}", f"output = {source}"), ('_unit = "V"', f'_unit = "{labelled}"')]
    if name == "motor-modbus-tcp.toml":  # room above what trips, in the other unit
        changes.append(("low = -8.0, high = 8.0", "low = -9e3, high = 9e3"))
        changes.append(('type = "int32", scale = 1.0e-6', 'type = "int32", scale = 1.0e-4'))
    found = flaws(folder, name, *changes)
    assert set(found) == ({"signals.output"} if words else set())
    assert words in found.get("signals.output", "")


def test_a_signal_that_is_labelled_with_its_own_unit_is_taken_as_it_stands(folder: Path) -> None:
    old = '{ signal = "INV_STATE.N_ACT", scale = 2.1502e-3 }'
    changes = [(old, '"INV_STATE.N_ACT"'), ('output_unit = "V"', 'output_unit = "rpm"')]
    assert flaws(folder, "motor-inverter.toml", *changes) == {}


def test_a_command_in_another_unit_is_a_flaw(folder: Path) -> None:
    dbc = (EXAMPLES / "inverter.dbc").read_text()
    assert '[0|600] "V"' in dbc
    (folder / "inverter.dbc").write_text(dbc.replace('[0|600] "V"', '[0|600] "%"'))
    found = flaws(folder, "motor-inverter.toml")
    assert found["signals.command.boost_reference_V"].startswith(
        "HOST_CMD.U_DC_SET: the signal is in %, the quantity in V"
    )


@pytest.mark.parametrize(
    ("unit", "given", "words"),
    [
        ("mV", '"boost_voltage"', "unit = 'mV' converts it"),
        ("mV", '{ signal = "boost_voltage", unit = "mV" }', ""),
        ("mV", '{ signal = "boost_voltage", unit = "kV" }', "the signal is in mV, and unit = 'kV'"),
        ("rpm", '"boost_voltage"', "the signal is in rpm, the quantity in V"),
        ("of the boost", '"boost_voltage"', ""),
    ],
)
def test_a_register_unit_of_another_quantity_is_a_flaw(
    folder: Path, unit: str, given: str, words: str
) -> None:
    register = 'scale = 0.01, unit = "V", range = { low = 0.0, high = 600.0 } }      # 40017'
    wide = f'scale = 10.0, unit = "{unit}", range = {{ low = 0.0, high = 6e5 }} }}'
    found = flaws(
        folder,
        "bath-modbus-tcp.toml",
        (register, wide),
        ('boost_voltage_V = "boost_voltage"', f"boost_voltage_V = {given}"),
    )
    assert set(found) == ({"signals.boost_voltage_V"} if words else set())
    assert words in found.get("signals.boost_voltage_V", "")
