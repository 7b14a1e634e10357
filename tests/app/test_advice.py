"""Values that can be used but are probably not meant give a warning with the figures."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.app.advice import advice
from adaptdrive.cli import main
from adaptdrive.config import load_configuration, parse_configuration
from adaptdrive.errors import Flaw

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"


def found(name: str, old: str, new: str) -> list[Flaw]:
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    assert old in text
    return list(advice(parse_configuration(text.replace(old, new), EXAMPLES / name)))


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_no_example_needs_advice(path: Path) -> None:
    assert [one for one in advice(load_configuration(path)) if "password" not in one.place] == []


def test_a_drive_that_holds_its_voltage_has_the_power_of_its_own_limit_alone() -> None:
    """It takes no k: `current_scale_max_S` limits nothing there."""
    little = "current_scale_max_S = 0.01 "
    assert found("bath-modbus-tcp.toml", "[drive.limits]", f"[drive.limits]\n{little}") == []
    (flaw,) = found(
        "bath-modbus-tcp.toml", "[drive.limits]", "[drive.limits]\nload_power_max_W = 500.0"
    )
    assert "drive.limits.load_power_max_W gives 500 W" in flaw.message


@pytest.mark.parametrize("place", ["bus", "sensor_bus.0"])
def test_a_message_that_is_asked_for_and_not_read_gives_a_warning(place: str) -> None:
    polled = 'databases = ["inverter.dbc"]\npolled = { INV_STATE = "rtr", DriveLoad = "rtr" }\n'
    sensors = """[[sensor_bus]]
name = "bench"
type = "can"
interface = "udp_multicast"
channel = "239.74.163.7"
database = "adaptdrive.dbc"
polled = { DriveStatus = "rtr", DriveLoad = "rtr" }
cycle_s = 0.05
signals = { brake = "DriveLoad.LoadCurrent" }
"""
    old, new = {
        "bus": ("[bus]\n", f"[bus]\n{polled}"),
        "sensor_bus.0": ("[interlocks]", f"{sensors}\n[interlocks]"),
    }[place]
    (flaw,) = found("motor.toml", old, new)
    name = "INV_STATE" if place == "bus" else "DriveStatus"
    assert flaw.place == f"{place}.polled.{name}"
    assert f"'rtr': no signal of {name!r} is read" in flaw.message


@pytest.mark.parametrize(
    ("name", "old", "new", "place", "words"),
    [
        (
            "motor.toml",
            "gain = 0.011 ",
            "gain = 0.008 ",
            "load.reference_max",
            "4.5 V cannot be reached: 400 V gives 3.2 V",
        ),
        (
            "bath.toml",
            "current_scale_max_S = 0.15 ",
            "current_scale_max_S = 0.05 ",
            "load.reference_max",
            # the heater takes 950.6 W for 20 K, and R_d 12.7 % more
            "takes 1071 W; drive.limits.current_scale_max_S gives 720 W",
        ),
        (
            "battery.toml",
            "reference_max = 14.0 ",
            "reference_max = 15.9 ",
            "load.reference_max",
            "takes 1557 W; drive.limits.load_power_max_W gives 1500 W",
        ),
        (
            "motor.toml",
            "tau_lambda_s = 10.0 ",
            "tau_lambda_s = 100.0 ",
            "estimator.tau_lambda_s",
            "mean time constant of 10.85 s: 2.17…54.2 s",
        ),
        ("motor.toml", "period_s = 1.0 ", "period_s = 10.0 ", "load.period_s", "0.108…5.42 s"),
        ("motor.toml", "pole = 0.70 ", "pole = 0.3\npole_min = 0.3 ", "load.pole", "at least 0.34"),
        (
            "battery.toml",
            "reference_max_V = 400.0",
            "reference_max_V = 328.0",
            "load.charge.voltage_max_V",
            "82 V is never passed, so that no charge ends by itself: V_c = 328 V gives 82 V",
        ),
        ("motor.toml", '"127.0.0.1"', '"broker.site"', "mqtt.tls", "'broker.site' is remote"),
        (
            "motor.toml",
            "port = 1883",
            'port = 1883\npassword_file = "nowhere"',
            "mqtt.password_file",
            "cannot be read",
        ),
    ],
)
def test_a_doubtful_value_is_named_with_its_figures(
    name: str, old: str, new: str, place: str, words: str
) -> None:
    (flaw,) = found(name, old, new)
    assert flaw.place == place
    assert words in flaw.message


def test_an_estimator_that_is_not_the_papers_is_named_in_the_papers_design() -> None:
    flaws = found("bath.toml", 'type = "bath"', 'type = "bath"\ndesign = "paper"')
    assert {flaw.place: flaw.message for flaw in flaws} == {
        "estimator.method": "'lm-rls': the paper has 'rls' here",
        "estimator.forgetting": "0.97: the paper has 0.99; leave the key out for it",
    }
    assert found("motor.toml", 'type = "motor"', 'type = "motor"\ndesign = "paper"') == []


@pytest.mark.parametrize(
    ("name", "timeout_s", "words"),
    [
        ("motor.toml", 0.051, ""),
        (
            "motor.toml",
            0.05,
            "0.05 s is not longer than 0.05 s, the silence after which the daemon",
        ),
        ("motor.toml", 0.02, "two and a half times the 8.333 ms from one command to the next, nor"),
        ("motor-inverter.toml", 0.1, "0.1 s is not longer than 0.1 s, the silence"),
        ("motor-modbus-tcp.toml", 0.36, ""),
        (
            "motor-modbus-tcp.toml",
            0.35,
            "longer time-out in the drive, or lower interlocks.stale_s",
        ),
        ("motor-modbus-rtu.toml", 0.25, "or lower bus.poll_ticks and interlocks.stale_s"),
    ],
)
def test_a_time_out_that_ends_before_the_daemon_drives_on_is_named(
    name: str, timeout_s: float, words: str
) -> None:
    configuration = load_configuration(EXAMPLES / name)
    bus = configuration.bus.model_copy(update={"command_timeout_s": timeout_s})
    flaws = list(advice(configuration.model_copy(update={"bus": bus})))
    assert [flaw.place for flaw in flaws] == ["bus.command_timeout_s"] * bool(words)
    assert all(words in flaw.message for flaw in flaws)


def test_a_report_of_the_bridge_that_may_be_the_command_itself_is_named() -> None:
    (flaw,) = found("motor-modbus-tcp.toml", 'bridge = "status"', 'bridge = "control"')
    assert flaw.place == "signals.bridge"
    assert "'control' lies in the register of signals.command.bridge" in flaw.message


@pytest.mark.parametrize(
    ("heartbeat_s", "timeout_s", "survived"),
    [(0.02, 0.1, None), (0.025, 0.1, None), (0.04, 0.1, 1), (0.05, 0.125, 1), (0.04, 0.16, None)],
)
def test_heartbeats_of_which_few_may_be_lost_are_named(
    heartbeat_s: float, timeout_s: float, survived: int | None
) -> None:
    configuration = load_configuration(EXAMPLES / "motor-cia402.toml")
    changes = {"heartbeat_s": heartbeat_s, "heartbeat_timeout_s": timeout_s}
    bus = configuration.bus.model_copy(update=changes)
    flaws = list(advice(configuration.model_copy(update={"bus": bus})))
    assert [flaw.place for flaw in flaws] == ([] if survived is None else ["bus.heartbeat_s"])
    assert all(f"no more than {survived} in a row may be lost" in one.message for one in flaws)


def test_the_longer_of_stale_s_and_stale_cycles_is_held_against_the_time_out() -> None:
    (flaw,) = found("motor-inverter.toml", "stale_cycles = 4.0", "stale_cycles = 8.0")
    assert flaw.message == (
        "0.15 s is not longer than 0.2 s, the silence after which the daemon trips: the drive "
        "stops by itself before; set a longer time-out in the drive, or lower bus.stale_cycles"
    )


@pytest.mark.parametrize(
    ("cycle_ms", "clock_ticks", "timeout_s", "named"),
    [
        (80, 1, None, []),
        (81, 1, None, ["message 'DriveStatus' comes every 81 ms: after 80 ms"]),
        (500, 1, None, ["message 'DriveStatus' comes every 500 ms: after 80 ms"]),
        (500, 1, 0.58, ["message 'DriveStatus' comes every 500 ms: after 80 ms"]),
        (500, 1, 0.59, []),
        (0, 1, None, ["message 'DriveStatus' has no GenMsgCycleTime: after 80 ms"]),
        (0, 1, 1.0, []),
        (240, 12, None, []),
        (260, 12, None, ["message 'DriveStatus' comes every 260 ms: after 250 ms"]),
    ],
)
def test_a_report_of_the_bridge_that_comes_too_seldom_is_named(
    tmp_path: Path, cycle_ms: int, clock_ticks: int, timeout_s: float | None, named: list[str]
) -> None:
    text = (EXAMPLES / "adaptdrive.dbc").read_text(encoding="utf-8")
    text = text.replace("BO_ 256 8;", f"BO_ 256 {cycle_ms};")
    (tmp_path / "seldom.dbc").write_text(text, encoding="utf-8")
    configuration = load_configuration(EXAMPLES / "motor.toml")
    bus = {
        "database": tmp_path / "seldom.dbc",
        "clock_ticks": clock_ticks,
        "command_timeout_s": timeout_s,
    }
    configuration = configuration.model_copy(
        update={
            "bus": configuration.bus.model_copy(update=bus),
            "voltage_loop": configuration.voltage_loop.model_copy(update={"where": "drive"}),
            "interlocks": configuration.interlocks.model_copy(update={"stale_s": 0.3}),
        }
    )
    flaws = [one for one in advice(configuration) if one.place == "signals.bridge"]
    assert [one.message[: len(words)] for one, words in zip(flaws, named, strict=True)] == named


@pytest.mark.parametrize(
    ("bridge", "named"),
    [
        ('"INV_STATE.STATE"', ["1 (Ready) alone means on, and 2 (Run), 3 (Fault) that the bridge"]),
        ('{ signal = "INV_STATE.STATE", on = 1 }', []),
    ],
)
def test_a_bridge_of_several_states_of_which_none_is_chosen_is_named(
    bridge: str, named: list[str]
) -> None:
    chosen = 'bridge = { signal = "INV_STATE.STATE", on = "Run" }'
    flaws = found("motor-inverter.toml", chosen, f"bridge = {bridge}")
    assert [flaw.place for flaw in flaws] == ["signals.bridge.on"] * len(named)
    assert all(words in flaw.message for flaw, words in zip(flaws, named, strict=True))


def test_check_warns_and_accepts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (EXAMPLES / "motor.toml").read_text(encoding="utf-8")
    (tmp_path / "adaptdrive.dbc").write_bytes((EXAMPLES / "adaptdrive.dbc").read_bytes())
    path = tmp_path / "motor.toml"
    path.write_text(text.replace('"127.0.0.1"', '"10.0.0.9"'), encoding="utf-8")
    assert main(["check", str(path)]) == 0
    answer = capsys.readouterr()
    assert f"adaptdrive: {path}: warning: mqtt.tls: false, and '10.0.0.9' is remote" in answer.err
    assert "is configured correctly" in answer.out


def test_check_names_warnings_and_the_contradiction_that_they_explain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (EXAMPLES / "motor-modbus-tcp.toml").read_text(encoding="utf-8")
    path = tmp_path / "motor.toml"
    text = text.replace("tau_motor_s = 11.7", "tau_motor_s = 0.5")
    text = text.replace("tau_filter_s = 10.0", "tau_filter_s = 0.1")
    path.write_text(text, encoding="utf-8")
    assert main(["check", str(path)]) == 2
    shown = capsys.readouterr().err
    assert "warning: load.period_s: 1 s does not suit lags of 0.6 s in all" in shown
    assert "load.pole: 0.7: the fixed controller must keep a load stable" in shown


def test_no_slow_period_is_proposed_that_the_polls_do_not_allow() -> None:
    device = EXAMPLES.parent / "devices" / "siemens-v20.toml"
    text = device.read_text(encoding="utf-8").replace("tau_motor_s = 6.0", "tau_motor_s = 1.0")
    fast = text.replace("tau_filter_s = 1.0", "tau_filter_s = 0.1")
    for period, proposals in (("1.5", ["0.9…0.9 s"]), ("0.9", [])):
        written = fast.replace("period_s = 1.5", f"period_s = {period}")
        flaws = list(advice(parse_configuration(written, device)))
        texts = [flaw.message for flaw in flaws if flaw.place == "load.period_s"]
        assert [text.rpartition(": ")[2] for text in texts] == proposals


def test_a_power_limit_that_nobody_stated_for_an_inverter_is_no_warning() -> None:
    device = EXAMPLES.parent / "devices" / "siemens-v20.toml"
    text = device.read_text(encoding="utf-8")
    limited = text.replace("[drive.limits]", "[drive.limits]\nload_power_max_W = 900.0")
    for stated, named in ((text, False), (limited, True)):
        flaws = advice(parse_configuration(stated, device))
        assert ("signals.load_power_W" in {flaw.place for flaw in flaws}) is named
