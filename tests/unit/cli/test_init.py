"""`adaptdrive init`: each configuration passes `check`, or the missing signals are named."""

from __future__ import annotations

import io
import itertools
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from adaptdrive.app.examine import load_examined
from adaptdrive.app.starter import device_names
from adaptdrive.cli import main
from adaptdrive.config import load_configuration
from adaptdrive.config.bus import CanBus, CanOpenBus, Signals
from adaptdrive.config.load import LoadName
from adaptdrive.util.errors import ConfigurationError, Flaw

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
DEVICES = EXAMPLES.parent / "devices"
LOADS = ("motor", "bath", "battery")
BUSES = ("can", "modbus-tcp", "modbus-rtu", "canopen", "scpi")
DESCRIPTIONS = (
    ("can", "--dbc", "bath.dbc", '"K"', '"°C"'),
    ("canopen", "--eds", "cia402.eds", "=Tachometer", "=Tachometer °"),
)


class Terminal(io.StringIO):
    """Input that somebody types."""

    def isatty(self) -> bool:
        return True


def init(*words: str | Path) -> int:
    return main(["init", *map(str, words)])


@pytest.mark.parametrize(("load", "bus"), list(itertools.product(LOADS, BUSES)))
def test_every_load_on_every_bus_passes_check(load: str, bus: str, tmp_path: Path) -> None:
    assert init(load, "--bus", bus, "--name", "rig-7", "--directory", tmp_path) == 0
    assert main(["check", str(tmp_path / "rig-7.toml")]) == 0
    configuration = load_configuration(tmp_path / "rig-7.toml")
    assert (configuration.drive.name, configuration.load.type) == ("rig-7", load)
    assert configuration.bus.type == bus


def test_signals_of_a_foreign_dbc_are_proposed(tmp_path: Path) -> None:
    database = EXAMPLES / "inverter.dbc"
    assert init("motor", "--bus", "can", "--dbc", database, "--directory", tmp_path) == 0
    proposed = load_configuration(tmp_path / "motor.toml")
    by_hand = load_configuration(EXAMPLES / "motor-inverter.toml")
    assert isinstance(proposed.bus, CanBus)
    assert isinstance(by_hand.bus, CanBus)
    assert proposed.load.output_unit == "rad/s"
    assert proposed.bus.clock == by_hand.bus.clock
    assert proposed.bus.clock_ticks == by_hand.bus.clock_ticks
    for quantity in ("boost_voltage_V", "line_voltage_V", "load_power_W", "output"):
        assert getattr(proposed.signals, quantity).signal == (
            getattr(by_hand.signals, quantity).signal
        )
    faults = [[one.signal for one in found.signals.fault] for found in (proposed, by_hand)]
    assert faults[0] == faults[1] != []
    assert proposed.signals.bridge == by_hand.signals.bridge
    assert proposed.signals.command.bridge == by_hand.signals.command.bridge


def test_a_drive_that_sends_seldom_gets_a_stale_limit_that_fits(tmp_path: Path) -> None:
    text = (EXAMPLES / "inverter.dbc").read_text()
    database = tmp_path / "seldom.dbc"
    database.write_text(re.sub(r'("GenMsgCycleTime" BO_ \d+) 25;', r"\1 100;", text))
    assert init("motor", "--bus", "can", "--dbc", database, "--directory", tmp_path) == 0
    proposed = load_configuration(tmp_path / "motor.toml")
    assert isinstance(proposed.bus, CanBus)
    assert proposed.bus.clock_ticks == 12
    assert proposed.interlocks.stale_s == pytest.approx(0.3)


def _names(signals: Signals) -> dict[str, str | None]:
    """Return the signal of each quantity, measured and commanded."""
    measured = {f: getattr(signals, f) for f in Signals.model_fields}
    commanded = {f"command.{f}": v for f, v in signals.command}
    return {f: getattr(v, "signal", None) for f, v in (measured | commanded).items()}


@pytest.mark.parametrize("load", LOADS)
def test_the_reference_dbc_is_understood(load: str, tmp_path: Path) -> None:
    database = EXAMPLES / ("adaptdrive.dbc" if load == "motor" else f"{load}.dbc")
    assert init(load, "--bus", "can", "--dbc", database, "--directory", tmp_path) == 0
    proposed = load_configuration(tmp_path / f"{load}.toml")
    by_hand = load_configuration(EXAMPLES / f"{load}.toml")
    assert _names(proposed.signals) == _names(by_hand.signals)


def test_objects_of_an_eds_are_proposed(tmp_path: Path) -> None:
    eds = EXAMPLES / "cia402.eds"
    assert init("motor", "--bus", "canopen", "--eds", eds, "--directory", tmp_path) == 0
    signals = load_configuration(tmp_path / "motor.toml").signals
    assert signals.boost_voltage_V is not None
    assert signals.boost_voltage_V.signal == "0x6079"
    assert signals.output is not None
    assert signals.output.signal == "0x2001.2"


def test_the_file_of_a_like_device_takes_the_eds_of_the_user(tmp_path: Path) -> None:
    eds = tmp_path / "mine.eds"
    eds.write_bytes((DEVICES / "maxon-epos4.eds").read_bytes())
    assert init("motor", "--device", "maxon-epos4", "--eds", eds, "--directory", tmp_path) == 0
    bus = load_configuration(tmp_path / "motor.toml").bus
    assert isinstance(bus, CanOpenBus)
    assert bus.eds == eds
    assert sorted(one.name for one in tmp_path.iterdir()) == ["mine.eds", "motor.toml"]


def test_a_register_map_takes_no_eds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ("--device", "delta-ms300", "--eds", EXAMPLES / "cia402.eds")
    assert init("motor", *given, "--directory", tmp_path) == 2
    assert "delta-ms300: has no bus.eds" in capsys.readouterr().err


ABOUT_THE_LOAD = r"""(?x)
    load\.model | (signals|derived|sensor_bus\.\d+\.signals)\.output
    | drive\.limits\.boost_reference_min_V: .* has \s no \s direction
    | signals\.load_power_W: \s Field \s required"""


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("device", device_names())
def test_a_device_with_another_load_lacks_only_what_the_load_needs(
    device: str, load: LoadName, tmp_path: Path
) -> None:
    init(load, "--device", device, "--name", "mine", "--directory", tmp_path)
    path = tmp_path / "mine.toml"
    text = path.read_text()
    described = tomllib.loads((DEVICES / f"{device}.toml").read_text())["load"]["type"]
    assert ("it must give the output of the" in text) is (load != described)
    assert tomllib.loads(text)["load"]["type"] == load
    found = [str(flaw) for flaw in _flaws(path)]
    assert load != described or not found
    assert [one for one in found if not re.match(ABOUT_THE_LOAD, one)] == []


def _flaws(path: Path) -> tuple[Flaw, ...]:
    try:
        load_examined(path)
    except ConfigurationError as error:
        return tuple(error.flaws)
    return ()


def test_an_eds_without_what_every_drive_needs_is_refused_before_a_question(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", Terminal(""))
    eds = tmp_path / "old.eds"
    text = (EXAMPLES / "cia402.eds").read_text().replace("[1017", "[5017")
    eds.write_text(text)
    assert init("motor", "--bus", "canopen", "--eds", eds, "--directory", tmp_path) == 2
    assert "the EDS has no object 0x1017" in capsys.readouterr().err


def test_a_missing_signal_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    database = tmp_path / "poor.dbc"
    text = (EXAMPLES / "adaptdrive.dbc").read_text()
    lines = [line for line in text.splitlines(keepends=True) if "LineVoltage" not in line]
    database.write_text("".join(lines))
    assert init("motor", "--bus", "can", "--dbc", database, "--directory", tmp_path) == 2
    assert "signals.line_voltage_V" in capsys.readouterr().out


def test_a_dbc_beside_the_configuration_is_named_without_its_folder(tmp_path: Path) -> None:
    database = tmp_path / "mine.dbc"
    database.write_bytes((EXAMPLES / "inverter.dbc").read_bytes())
    assert init("motor", "--bus", "can", "--dbc", database, "--directory", tmp_path) == 0
    assert 'database = "mine.dbc"' in (tmp_path / "motor.toml").read_text()


def test_an_existing_file_is_never_replaced(tmp_path: Path) -> None:
    file = tmp_path / "motor.toml"
    file.write_text("mine")
    assert init("motor", "--bus", "can", "--directory", tmp_path) == 2
    assert file.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [file]


def test_a_description_for_another_bus_is_refused(tmp_path: Path) -> None:
    assert init("motor", "--bus", "modbus-tcp", "--dbc", EXAMPLES / "bath.dbc") == 2
    assert init("motor", "--bus", "can", "--eds", EXAMPLES / "cia402.eds") == 2


def test_an_unreadable_dbc_is_one_clear_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = tmp_path / "no.dbc"
    assert init("motor", "--bus", "can", "--dbc", missing, "--directory", tmp_path) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_each_proposal_can_be_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter(["", "INV_ACT.U_MAINS", "INV_ACT.U_DC", "0"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: next(answers, ""))
    database = EXAMPLES / "inverter.dbc"
    init("motor", "--bus", "can", "--dbc", database, "--directory", tmp_path)
    text = (tmp_path / "motor.toml").read_text()
    assert 'signal = "INV_STATE.N_ACT"' in text
    assert 'boost_voltage_V = "INV_ACT.U_MAINS"' in text
    assert 'line_voltage_V = "INV_ACT.U_DC"' in text
    assert "# load_power_W = " in text


def test_limits_range_line_and_broker_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What nobody has changed is named by `check`; what is no number is asked for again."""
    answers = iter(["50", "230", "340", "", "", "many", "4.4", "", "drives.example.org"])
    questions: list[str] = []

    def answer(question: str) -> str:
        questions.append(question)
        return next(answers)

    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", answer)
    init("motor", "--bus", "can", "--directory", tmp_path)
    assert "frequency of the line in Hz [60]: " in questions
    configuration = load_configuration(tmp_path / "motor.toml")
    assert configuration.drive.line_frequency_Hz == 50
    assert configuration.drive.line_voltage_V == 230
    assert configuration.load.reference_max == 4.4
    assert configuration.mqtt.host == "drives.example.org"
    capsys.readouterr()
    main(["check", str(tmp_path / "motor.toml")])
    warning = capsys.readouterr().err.partition("values of the example: ")[2]
    assert "interlocks.output_max = 5.0" in warning
    assert "reference_max" not in warning.replace("boost_reference_max", "")
    assert "line_voltage_V" not in warning


def test_a_changed_example_is_named_no_more(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert init("motor", "--bus", "can", "--directory", tmp_path) == 0
    path = tmp_path / "motor.toml"
    path.write_text(path.read_text().replace("# example: ", "# "))
    capsys.readouterr()
    assert main(["check", str(path)]) == 0
    assert "values of the example" not in capsys.readouterr().err


def test_what_is_true_of_the_example_alone_is_named_until_it_is_adapted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert init("bath", "--bus", "scpi", "--directory", tmp_path) == 0
    path = tmp_path / "bath.toml"
    for text, end in ((path.read_text(), "is not configured yet"), ("", "is configured correctly")):
        path.write_text(text or path.read_text().replace("# example: ", "# "))
        capsys.readouterr()
        assert main(["check", str(path)]) == 0
        shown = capsys.readouterr()
        assert f"drive bath {end}" in shown.out
        assert ("bus.command_timeout_s = 1.0" in shown.err) is bool(text)


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("load", LOADS)
def test_a_simulated_drive_gets_limits_for_a_shared_machine(
    load: str, bus: str, tmp_path: Path
) -> None:
    """A machine that others use delays a process by 0.2 s; docs/own-drive.md states the limits."""
    assert init(load, "--bus", bus, "--directory", tmp_path) == 0
    shared = load_configuration(tmp_path / f"{load}.toml")
    assert 0.5 <= shared.interlocks.stale_s <= 0.55  # that of a serial line
    assert isinstance(shared.bus, CanOpenBus) or shared.bus.command_timeout_s == 1.0


def test_a_drive_that_is_described_gets_the_limits_of_a_real_bus(tmp_path: Path) -> None:
    database = EXAMPLES / "inverter.dbc"
    assert init("motor", "--bus", "can", "--dbc", database, "--directory", tmp_path) == 0
    assert load_configuration(tmp_path / "motor.toml").interlocks.stale_s < 0.1


def test_an_end_of_the_input_is_one_clear_error_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", Terminal(""))
    database = EXAMPLES / "inverter.dbc"
    assert init("motor", "--bus", "can", "--dbc", database, "--directory", tmp_path) == 2
    assert "the input ended before an answer; nothing is written" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("description", DESCRIPTIONS)
def test_a_description_is_read_in_each_encoding_of_its_editors(
    description: tuple[str, ...], encoding: str, tmp_path: Path
) -> None:
    bus, option, file, old, new = description
    text = (EXAMPLES / file).read_text(encoding="utf-8").replace(old, new)
    assert new in text
    texts = []
    for name, content in (("plain", text), ("other", text.replace("\n", "\r\n"))):
        place = tmp_path / name / file
        place.parent.mkdir()
        place.write_bytes(content.encode(encoding if name == "other" else "utf-8"))
        init("bath", "--bus", bus, option, place, "--directory", place.parent)
        texts.append((place.parent / "bath.toml").read_text().replace(str(place), file))
    assert texts[1] == texts[0]
    assert option == "--eds" or 'unit = "degC"' in texts[1]


@pytest.mark.parametrize("name", ["", "../x", "a/b", "a b", "mötor", "x" * 300])
def test_a_name_that_no_drive_can_have_writes_nothing(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "below"
    assert init("motor", "--bus", "can", "--directory", folder, "--name", name) == 2
    assert "--name" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_link_to_nothing_and_a_folder_are_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "motor.toml").symlink_to(tmp_path / "nothing" / "x")
    (tmp_path / "adaptdrive.dbc").mkdir()
    for name in ("motor", "other"):
        assert init("motor", "--bus", "can", "--directory", tmp_path, "--name", name) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "other.toml").exists()


def test_no_text_of_a_description_leaves_its_place_in_the_file(tmp_path: Path) -> None:
    text = (EXAMPLES / "inverter.dbc").read_text()
    text = text.replace('"rpm"', '"rpm\nevil = 1"').replace('"Run"', '"Ru\\\\n"')
    database = tmp_path / 'my "drive".dbc'
    database.write_text(text)
    init("motor", "--bus", "can", "--dbc", database, "--directory", tmp_path)
    tables = tomllib.loads((tmp_path / "motor.toml").read_text())
    assert tables["bus"]["database"] == database.name
    assert "evil" not in str(tables)


def test_the_parser_quotes_a_file_that_is_no_text_in_part(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    database = tmp_path / "binary.dbc"
    database.write_bytes(b"\xfe" * 100_000)
    assert init("motor", "--bus", "can", "--dbc", database, "--directory", tmp_path) == 2
    assert len(capsys.readouterr().err) < 1000


def test_the_commands_that_come_next_can_be_pasted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "test rig"
    assert init("motor", "--bus", "can", "--directory", folder) == 0
    pasted = [shlex.split(line, comments=True) for line in capsys.readouterr().out.splitlines()]
    assert ["adaptdrive", "check", str(folder / "motor.toml")] in pasted
