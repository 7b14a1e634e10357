"""The command line in this process: exit status, and one clear line for every error.

The lines of refusals are in `refusals.txt`; `tests/golden.py` says how they are renewed.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cyclopts import App
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive import __version__
from adaptdrive.cli import carry_out, main, operate
from adaptdrive.cli.options import build_app, parsed_command
from adaptdrive.cli.programs import per_second
from adaptdrive.config import Configuration
from adaptdrive.config.services import Mqtt
from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive.mqtt.client import DriveStatus, NoAnswerError
from adaptdrive.mqtt.commands import Payload
from adaptdrive.mqtt.contract import Reply
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import (
    REQUESTS,
    Choose,
    Disable,
    Enable,
    End,
    HoldFor,
    Program,
    RampTo,
    Reload,
    Request,
    Reset,
    RunProgram,
    SetMode,
    SetPole,
    SetSetpoint,
    SetVoltage,
    SetWaveform,
    Turn,
    WaveFor,
)
from adaptdrive.util.quantity import Display
from adaptdrive_sim.cli import app as sim_app
from tests.golden import hold
from tests.unit.cli.here import run_here

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "motor.toml"
PROGRAM = EXAMPLE.parents[1] / "programs" / "motor.toml"
CYCLE = Program(
    "cycle",
    (
        Choose("adaptive"),
        RampTo(3.2, 0.5),
        HoldFor(10.0),
        WaveFor(Shape.SINE, 2.8, 3.6, 8.0, 24.0),
        RampTo(2.4, 0.2),
    ),
    End.DISABLE,
)
C_LOCALE = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
"""What leaves Python with ASCII."""


class Drive:
    """Stands for a drive behind a broker: keeps what it is asked, and answers.

    Attributes:
        asked: The requests.
        refusal: Reason of its refusals, empty to accept.
        trip_kind: Kind of the trip for which it refuses.
        problem: Why it does not answer, empty to answer.
        display: Unit in which people see its output.
    """

    def __init__(self) -> None:
        self.asked: list[Request] = []
        self.refusal = self.problem = ""
        self.display = Display()
        self.trip_kind: str | None = None
        self.status = DriveStatus("online", {"state": "standby", "mode": "fixed"}, live=True)

    async def send(
        self, _: Mqtt, drive: str, verb: str, value: object, __: float, **more: object
    ) -> Reply:
        raw = json.dumps({"id": "7", "value": value, **more}).encode()
        self.asked.append(Payload(raw).request(verb)[0])
        if self.problem:
            raise NoAnswerError(drive, self.problem)
        accepted = not self.refusal
        state = State.RUNNING if accepted else None
        return Reply("7", verb, accepted, self.refusal, state, self.trip_kind)

    async def tell(self, _: Mqtt, drive: str, __: float) -> DriveStatus:
        if self.problem:
            raise NoAnswerError(drive, self.problem)
        return self.status

    async def tell_display(self, _: Mqtt, drive: str, __: float) -> Display:
        if self.problem:
            raise NoAnswerError(drive, self.problem)
        return self.display


@pytest.fixture
def drive(monkeypatch: pytest.MonkeyPatch) -> Drive:
    stand_in = Drive()
    monkeypatch.setattr(operate, "send_command", stand_in.send)
    monkeypatch.setattr(operate, "read_status", stand_in.tell)
    monkeypatch.setattr(operate, "read_display", stand_in.tell_display)
    return stand_in


def outcome(*words: str, **environment: str) -> tuple[int, str, str]:
    """Exit status, output and errors of a command."""
    done = run_here(*words, **environment)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("words", "request_"),
    [
        ("setpoint bench 3.1", SetSetpoint(3.1)),
        ("setpoint bench -3", SetSetpoint(-3.0)),
        ("setpoint bench 3 --ramp 0.5/s", SetSetpoint(3.0, 0.5)),
        ("setpoint bench 3 --ramp 3/min", SetSetpoint(3.0, 0.05)),
        ("setpoint bench 3 --ramp 36/h", SetSetpoint(3.0, 0.01)),
        ("setpoint bench 3 --ramp 2", SetSetpoint(3.0, 2.0)),
        ("waveform bench square 3 3.2 120", SetWaveform(Waveform(Shape.SQUARE, 3.0, 3.2, 120.0))),
        ("waveform bench sine -1 1 5", SetWaveform(Waveform(Shape.SINE, -1.0, 1.0, 5.0))),
        ("waveform bench off", SetWaveform(None)),
        ("program pause bench", RunProgram(Turn.PAUSE)),
        (f"program start bench {PROGRAM}", RunProgram(CYCLE)),
        ("pole bench 0.8", SetPole(0.8)),
        ("mode bench adaptive", SetMode(Mode.ADAPTIVE)),
        ("manual bench", SetMode(Mode.MANUAL)),
        ("voltage bench 280", SetVoltage(280.0)),
        ("voltage bench 280 --hold 5", SetVoltage(280.0, hold_s=5.0)),
        ("enable bench", Enable()),
        ("disable bench", Disable()),
        ("reload bench", Reload()),
        ("reset bench", Reset()),
    ],
)
def test_an_accepted_command_ends_with_0(drive: Drive, words: str, request_: Request) -> None:
    status, output, errors = outcome(*words.split())
    verb = type(request_).verb
    assert (status, output, errors) == (0, f"bench: {verb} accepted, running\n", "")
    assert drive.asked == [request_]


@pytest.mark.parametrize(
    ("text", "flaw"),
    [
        ('[[steps]]\ndo = "ramp"', "step 1: Object missing required field `to`"),
        ('steps = [{do = "hold", for_s = 1}, {do = "rest"}]', "step 2.do: Invalid value 'rest'"),
        ('steps = [{do = "hold", for_s = "2 h"}]', "step 1.for_s: Expected `float`, got `str`"),
        ("steps = []", "steps: Expected `array` of length >= 1"),
        ("steps", "program: Expected '='"),
    ],
)
def test_a_file_that_is_no_program_is_refused_with_the_place(
    drive: Drive, tmp_path: Path, text: str, flaw: str
) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    status, output, errors = outcome("program", "start", "bench", str(file))
    assert (status, output) == (2, "")
    assert f"{file}: {flaw}" in errors
    assert drive.asked == []


@given(st.floats(1e-9, 1e9), st.sampled_from([("s", 1.0), ("min", 60.0), ("h", 3600.0)]))
def test_a_slope_is_read_with_its_unit(number: float, unit: tuple[str, float]) -> None:
    name, factor = unit
    assert per_second(f"{number!r}/{name}") == number / factor


@pytest.mark.parametrize("text", ["0/h", "-2/s", "nan", "inf/s", "2/d", "x/s"])
def test_what_is_no_slope_is_refused(drive: Drive, text: str) -> None:
    status, _, errors = outcome("setpoint", "bench", "3", f"--ramp={text}")
    assert (status, f'"{text}" is no slope' in errors, drive.asked) == (2, True, [])


@pytest.mark.parametrize(
    ("words", "request_"),
    [
        ("setpoint bench 3 --ramp 2", SetSetpoint(3.0, 2.0, unit="rpm")),
        ("setpoint bench 3Hz --ramp 2Hz/s", SetSetpoint(3.0, 2.0, unit="Hz")),
        ("setpoint bench 3 --ramp 120Hz/min", SetSetpoint(3.0, 2.0, unit="Hz")),
        (
            "waveform bench sine 1 3Hz 5",
            SetWaveform(Waveform(Shape.SINE, 1.0, 3.0, 5.0), unit="Hz"),
        ),
        (
            f"program start bench {PROGRAM}",
            RunProgram(msgspec.structs.replace(CYCLE, unit="rpm")),
        ),
    ],
)
def test_a_command_names_the_unit_that_is_shown_or_typed(
    drive: Drive, words: str, request_: Request
) -> None:
    drive.display = Display("rpm", 400.0)
    assert outcome(*words.split())[0] == 0
    assert drive.asked == [request_]


def test_two_units_in_one_command_are_refused(drive: Drive) -> None:
    status, _, errors = outcome(*["setpoint", "bench", "3rpm", "--ramp", "2Hz/s"])
    assert (status, drive.asked) == (2, [])
    assert "setpoint in Hz and rpm" in errors


@pytest.mark.parametrize(
    ("words", "needed"), [("start bench", "start needs a FILE"), ("stop bench x", "no FILE")]
)
def test_an_action_of_a_program_takes_what_it_needs(drive: Drive, words: str, needed: str) -> None:
    status, _, errors = outcome("program", *words.split())
    assert (status, needed in errors, drive.asked) == (2, True, [])


def test_each_command_has_its_words() -> None:
    assert all(callable(getattr(operate, verb)) for verb in REQUESTS)


def test_a_refused_command_ends_with_1_and_the_reason(drive: Drive) -> None:
    drive.refusal = "setpoint = 9 V is outside 0…4.5 V"
    refused = f"adaptdrive: bench refused setpoint: {drive.refusal}\n"
    assert outcome("setpoint", "bench", "9") == (1, "", refused)
    drive.refusal = "tripped (drive fault: word 0x3); reset first"
    drive.trip_kind = "drive-fault"
    status, _, errors = outcome("enable", "bench")
    advice = errors.splitlines()[1]
    assert status == 1
    assert advice.startswith("adaptdrive: what to do: look the fault up")
    assert advice.endswith("  [drive-fault]")
    drive.trip_kind = "of-a-later-version"
    assert outcome("enable", "bench")[2].count("\n") == 2


def test_a_reply_as_json_keeps_the_exit_status(drive: Drive) -> None:
    status, output, _ = outcome("setpoint", "bench", "3", "--json")
    assert (status, json.loads(output)["accepted"]) == (0, True)
    drive.refusal = "outside"
    status, output, _ = outcome("setpoint", "bench", "9", "--json")
    assert (status, json.loads(output)["reason"]) == (1, "outside")


@pytest.mark.parametrize("verb", ["enable", "status"])
def test_a_drive_that_does_not_answer_ends_with_3(drive: Drive, verb: str) -> None:
    drive.problem = "no answer within 5 s"
    assert outcome(verb, "bench") == (3, "", "adaptdrive: bench: no answer within 5 s\n")


def test_status_tells_people_and_programs(drive: Drive) -> None:
    status, output, errors = outcome("status", "bench")
    assert (status, errors) == (0, "")
    assert output.startswith("bench is online\n  state       standby")
    found = json.loads(outcome("status", "bench", "--json")[1])
    assert (found["live"], found["state"]["state"]) == (True, "standby")


@pytest.mark.parametrize(
    ("availability", "first"),
    [
        ("online", "bench is online by the broker, but no telemetry came: the daemon may be gone"),
        ("offline", "bench is offline"),
    ],
)
def test_a_drive_without_telemetry_is_not_shown_as_running(
    drive: Drive, availability: str, first: str
) -> None:
    """A broker that keeps messages on disk has restarted with the machine, the daemon has not."""
    drive.status = DriveStatus(availability, {"state": "running"})
    status, output, _ = outcome("status", "bench")
    assert (status, output.splitlines()[0][: len(first)]) == (3, first)
    assert "  last state  running" in output
    assert outcome("status", "bench", "--json")[0] == 3


def test_a_good_configuration_ends_with_0() -> None:
    assert outcome("check", str(EXAMPLE))[::2] == (0, "")


def test_a_configuration_without_an_end_ends_with_2() -> None:
    status, _, errors = outcome("check", "/dev/zero")
    assert status == 2
    assert "more than" in errors


def test_a_check_for_programs_lists_limits_and_flaws(tmp_path: Path) -> None:
    status, output, errors = outcome("check", "--json", str(EXAMPLE))
    report = json.loads(output)
    assert (status, errors, report["valid"], report["drive"]) == (0, "", True, "motor")
    assert report["output"] == {"name": "speed", "unit": "V", "display": None}
    stale = next(one for one in report["time_limits"] if "interlocks.stale_s" in one["keys"])
    assert stale["limit_s"] == tomllib.loads(EXAMPLE.read_text())["interlocks"]["stale_s"]
    flawed = tmp_path / "flawed.toml"
    flawed.write_text("unknown_key = 1\n" + EXAMPLE.read_text(encoding="utf-8"))
    status, output, _ = outcome("check", "--json", str(flawed))
    report = json.loads(output)
    assert (status, report["valid"]) == (2, False)
    assert "unknown_key" in [one["place"] for one in report["flaws"]]


@pytest.mark.parametrize(
    ("words", "status"), [("check", 2), ("run", 2), ("probe", 2), ("replay", 1)]
)
def test_a_missing_file_is_one_clear_line(tmp_path: Path, words: str, status: int) -> None:
    found, output, errors = outcome(words, str(tmp_path / "none.toml"))
    assert (found, output, errors.count("\n")) == (status, "", 1)
    assert errors.startswith("adaptdrive: ")
    assert "none.toml" in errors


def test_the_schema_is_the_one_of_the_configuration() -> None:
    status, output, _ = outcome("schema")
    assert (status, json.loads(output)) == (0, Configuration.model_json_schema())


def test_the_version() -> None:
    assert outcome("--version") == (0, f"{__version__} (pure Python)\n", "")


def test_completion_knows_the_commands(tmp_path: Path) -> None:
    place = tmp_path / "done"
    words = ("--install-completion", "--shell", "bash", "--output", str(place))
    assert outcome(*words, HOME=str(tmp_path))[0] == 0
    assert all(word in place.read_text("utf-8") for word in ("setpoint", "list", "--broker"))


@pytest.mark.parametrize("build", [build_app, lambda: sim_app])
def test_help_names_each_argument_as_a_person_would(
    build: Callable[[], App], capsys: pytest.CaptureFixture[str]
) -> None:
    app = build()
    for name in app:
        if not name.startswith("-") and name != "sessions":
            app([name, "--help"])
    text = capsys.readouterr().out
    assert "Usage: " in text
    assert not re.findall(r".*(?:ARGS|--empty-).*", text)


@pytest.mark.parametrize("columns", ["0", "2", "19", "200"])
def test_help_ends_in_a_terminal_of_few_columns(columns: str) -> None:
    status, output, errors = outcome("--help", COLUMNS=columns)
    assert (status, errors) == (0, "")
    assert "Usage:" in output
    assert columns != "200" or all(f" {name} " in output for name in ("run", "check", *REQUESTS))


def test_words_that_cannot_be_used_are_refused_in_clear_lines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "secret").write_bytes(65_536 * b"a")

    def answered(_: str, asked: list[str]) -> Iterator[str]:
        (words,) = asked
        plain = words.encode("latin-1", "backslashreplace").decode("unicode_escape")
        yield f"exit {main([one.replace('TMP', str(tmp_path)) for one in plain.split(' ')])}"
        output, errors = capsys.readouterr()
        assert output == ""
        yield from errors.replace(str(tmp_path), "TMP").splitlines()

    hold(Path(__file__).with_name("refusals.txt"), answered)


UNWRITABLE = "standard output cannot be written: {}; the command itself ended with status 0"
EARLY = "standard output cannot be written: {}; the command ended early"
FULL = "No space left on device"
LIST = "sessions list --json --directory ."


def written_to(
    place: str, words: str, program: str, monkeypatch: pytest.MonkeyPatch, **how: Any
) -> int:
    """Exit status of a command whose output goes to a file, or to a pipe that nobody reads."""
    if place == "a pipe":
        reading, descriptor = os.pipe()
        os.close(reading)
    else:
        descriptor = os.open(place, os.O_WRONLY | os.O_CREAT, 0o600)
    with os.fdopen(descriptor, "w", **{"encoding": "utf-8", **how}) as output:
        monkeypatch.setattr(sys, "stdout", output)
        if program == "adaptdrive":
            return main(words.split())
        return carry_out(program, parsed_command(sim_app, words.split()), words.split())


@pytest.mark.parametrize(
    ("program", "words", "place", "status", "errors"),
    [
        *(
            ("adaptdrive", words, "a pipe", 0, "")
            for words in (LIST, "--help", "sessions", "run --help", "--version")
        ),
        ("adaptdrive-sim", "demo --help", "a pipe", 0, ""),
        ("adaptdrive", LIST, "/dev/full", 1, UNWRITABLE.format(FULL)),
        ("adaptdrive", "schema", "/dev/full", 1, EARLY.format(FULL)),
        ("adaptdrive", "schema", "a pipe", 1, ""),
        ("adaptdrive-sim", "--help", "/dev/full", 1, EARLY.format(FULL)),
    ],
)
def test_output_that_nobody_takes_gives_no_traceback_and_no_false_status(
    *,
    program: str,
    words: str,
    place: str,
    status: int,
    errors: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert written_to(place, words, program, monkeypatch) == status
    assert capsys.readouterr().err == (f"{program}: {errors}\n" if errors else "")


@pytest.mark.parametrize(("place", "problem"), [("/dev/full", FULL), ("a pipe", "Broken pipe")])
def test_an_answer_that_cannot_be_printed_is_told_as_an_error(
    drive: Drive,
    place: str,
    problem: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert written_to(place, "enable bench", "adaptdrive", monkeypatch) == 0
    told = f"bench: enable accepted, running (standard output cannot be written: {problem})"
    assert capsys.readouterr().err == f"adaptdrive: {told}\n"
    assert drive.asked == [Enable()]


@pytest.mark.parametrize(
    "how", [{"encoding": "latin-1"}, {"encoding": "ascii", "errors": "surrogateescape"}], ids=str
)
def test_letters_that_the_terminal_lacks_are_escaped_and_a_path_keeps_its_bytes(
    how: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A script opens what a command has printed."""
    place = tmp_path / os.fsdecode(b"caf\xe9")
    place.mkdir()
    for name in ("motor.toml", "adaptdrive.dbc"):
        shutil.copy(EXAMPLE.with_name(name), place)
    shown = tmp_path / "shown"
    words = f"check {place}/motor.toml"
    assert written_to(str(shown), words, "adaptdrive", monkeypatch, **how) == 0
    output = shown.read_bytes()
    assert os.fsencode(place) + b"/motor.toml: drive motor is" in output
    assert rb"2.2\u20264.4 V" in output


@pytest.mark.usefixtures("outside")
@pytest.mark.parametrize(
    ("command", "status", "errors"),
    [
        (f"adaptdrive.cli {LIST} <&- >&- 2>&-", 0, ""),
        ("adaptdrive.cli schema | true; exit ${PIPESTATUS[0]}", 1, ""),
        (f"adaptdrive.cli {LIST} 1</dev/null", 1, UNWRITABLE.format("Bad file descriptor")),
    ],
)
def test_a_process_bears_standard_files_that_are_closed_or_end(
    tmp_path: Path, command: str, status: int, errors: str
) -> None:
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m {command}"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), **C_LOCALE},
    )
    assert done.returncode == status
    assert done.stderr == (f"adaptdrive: {errors}\n" if errors else "")


def test_a_configuration_whose_name_is_not_utf_8_is_checked_for_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / os.fsdecode(b"motor-\xff.toml")
    shutil.copy(EXAMPLE, file)
    shutil.copy(EXAMPLE.with_name("adaptdrive.dbc"), tmp_path)
    for name, status in ((file, 0), (tmp_path / os.fsdecode(b"\xff"), 2)):
        assert main(["check", "--json", str(name)]) == status
        assert json.loads(capsys.readouterr().out)["config"].startswith(str(tmp_path))
