"""The command line: exit status, and one clear line for every error."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from cyclopts import App

from adaptdrive import __version__
from adaptdrive.cli import main, operate
from adaptdrive.cli.commands import build_app
from adaptdrive.config import Configuration
from adaptdrive.control.signals import Estimate, Mode
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive.runtime.requests import (
    REQUESTS,
    Disable,
    Enable,
    Request,
    Reset,
    SetMode,
    SetPole,
    SetSetpoint,
    SetVoltage,
    SetWaveform,
)
from adaptdrive_sim.cli import app as sim_app
from tests.cli.here import run_here
from tests.operation.peers import (
    STANDBY,
    Bench,
    drive_report,
    listening,
    load_report,
    publish,
    serving,
)
from tests.support import Broker

EXAMPLE = Path(__file__).parents[2] / "deploy" / "examples" / "motor.toml"


@dataclass(frozen=True)
class Outcome:
    status: int
    output: str
    errors: str


C_LOCALE = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
"""What leaves Python with ASCII."""


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "COLUMNS": "200"}


async def start(*words: str) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "adaptdrive.cli", *words),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=_environment(),
    )


async def adaptdrive(*words: str) -> Outcome:
    process = await start(*words)
    output, errors = await process.communicate()
    assert process.returncode is not None
    return Outcome(process.returncode, output.decode(), errors.decode())


def here(*words: str) -> Outcome:
    done = run_here(*words)
    return Outcome(done.returncode, done.stdout, done.stderr)


@pytest.fixture
async def bench(mosquitto: Broker, tmp_path: Path) -> AsyncIterator[Bench]:
    async with serving(mosquitto, "bench", tmp_path) as running:
        yield running


def at(broker: Broker) -> tuple[str, str]:
    return ("--broker", f"{broker.host}:{broker.port}")


@pytest.mark.parametrize(
    ("words", "request_"),
    [
        ("setpoint bench 3.1", SetSetpoint(3.1)),
        ("waveform bench square 3 3.2 120", SetWaveform(Waveform(Shape.SQUARE, 3.0, 3.2, 120.0))),
        ("waveform bench sine -1 1 5", SetWaveform(Waveform(Shape.SINE, -1.0, 1.0, 5.0))),
        ("waveform bench off", SetWaveform(None)),
        ("pole bench 0.8", SetPole(0.8)),
        ("mode bench adaptive", SetMode(Mode.ADAPTIVE)),
        ("voltage bench 280", SetVoltage(280.0)),
        ("voltage bench 280 --hold 5", SetVoltage(280.0, hold_s=5.0)),
        ("enable bench", Enable()),
        ("disable bench", Disable()),
        ("reset bench", Reset()),
    ],
)
async def test_an_accepted_command_ends_with_0(bench: Bench, words: str, request_: Request) -> None:
    outcome = await adaptdrive(*words.split(), *at(bench.broker))
    verb = words.split(maxsplit=1)[0]
    state = "running" if verb == "enable" else "standby"
    assert outcome == Outcome(0, f"bench: {verb} accepted, {state}\n", "")
    assert bench.host.asked == [request_]


async def test_manual_is_a_mode(bench: Bench) -> None:
    assert (await adaptdrive("manual", "bench", *at(bench.broker))).status == 0
    assert bench.host.asked == [SetMode(Mode.MANUAL)]


def test_each_command_has_its_words() -> None:
    assert all(callable(getattr(operate, verb)) for verb in REQUESTS)


@pytest.mark.parametrize(("value", "reason"), [("-3", "outside"), ("9", "outside")])
async def test_a_refused_command_ends_with_1_and_the_reason(
    bench: Bench, value: str, reason: str
) -> None:
    outcome = await adaptdrive("setpoint", "bench", value, *at(bench.broker))
    assert (outcome.status, outcome.output) == (1, "")
    assert outcome.errors.startswith("adaptdrive: bench refused setpoint: ")
    assert reason in outcome.errors
    assert outcome.errors.count("\n") == 1


@pytest.mark.parametrize("verb", ["enable", "status"])
def test_a_drive_that_is_not_there_ends_with_3(mosquitto: Broker, verb: str) -> None:
    outcome = here(verb, "nobody", "--timeout", "0.3", *at(mosquitto))
    assert (outcome.status, outcome.output) == (3, "")
    assert outcome.errors.startswith("adaptdrive: nobody: no answer")
    assert outcome.errors.count("\n") == 1


@pytest.mark.parametrize("verb", ["enable", "status"])
def test_a_broker_that_is_not_there_ends_with_3(free_tcp_port: int, verb: str) -> None:
    outcome = here(verb, "bench", "--broker", f"127.0.0.1:{free_tcp_port}")
    assert (outcome.status, outcome.output) == (3, "")
    assert "refused" in outcome.errors
    assert outcome.errors.count("\n") == 1


async def test_the_answers_to_others_are_not_mine(mosquitto: Broker) -> None:
    asking = asyncio.create_task(adaptdrive("enable", "busy", "--timeout", "1", *at(mosquitto)))
    while not asking.done():
        for payload in ('{"id": "other", "verb": "enable", "accepted": true}', "{", ""):
            await publish(mosquitto, "adaptdrive/busy/reply", payload)
    assert (await asking).status == 3


async def status_of(bench: Bench, *more: str) -> Outcome:
    """What `status` says while the daemon publishes."""
    asking = asyncio.create_task(adaptdrive("status", bench.drive, *more, *at(bench.broker)))
    while not asking.done():
        bench.hub.publish(drive_report(600))
        await asyncio.sleep(0.05)
    return await asking


async def test_status_tells_people(bench: Bench) -> None:
    outcome = await status_of(bench)
    assert (outcome.status, outcome.errors) == (0, "")
    assert outcome.output.startswith("bench is online\n  state       standby")
    assert "fixed (asked for fixed)" in outcome.output


async def test_status_tells_what_the_letters_of_a_plain_locale_can(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in C_LOCALE.items():
        monkeypatch.setenv(name, value)
    report = load_report(5)
    estimates = {"gain": Estimate(0.0113, 0.0002)}
    async with listening(bench.broker, bench.topic("#")) as ear:
        bench.hub.publish(replace(report, decision=replace(report.decision, estimates=estimates)))
        await ear.on(bench.topic("telemetry/load"))
    outcome = await status_of(bench)
    assert (outcome.status, outcome.errors) == (0, "")
    assert outcome.output.isascii()
    assert "\\xb1" in outcome.output  # ±


async def test_a_drive_that_only_the_broker_remembers_is_not_shown_as_running(
    mosquitto: Broker,
) -> None:
    """A broker that keeps messages on disk has restarted with the machine, the daemon has not."""
    for name, payload in {
        "availability": "online",
        "state": '{"state": "running"}',
        "telemetry/load": '{"k": 5, "estimates": {}}',
    }.items():
        await publish(mosquitto, f"adaptdrive/remembered/{name}", payload, "-r")
    outcome = await adaptdrive("status", "remembered", *at(mosquitto))
    assert (outcome.status, outcome.errors) == (3, "")
    first, state, *_ = outcome.output.splitlines()
    assert "online by the broker, but no telemetry came: the daemon may be gone" in first
    assert state.startswith("  last state  running")
    outcome = await adaptdrive("status", "remembered", "--json", *at(mosquitto))
    assert outcome.status == 3
    assert json.loads(outcome.output)["live"] is False


async def test_status_is_complete_at_once_with_units_and_the_remedy(bench: Bench) -> None:
    """The last slow step is retained: no luck is needed to see it."""
    trip = "over-voltage: v_bst = 431 V, limit 430 V"
    async with listening(bench.broker, bench.topic("#")) as ear:
        bench.hub.publish(load_report(5))
        await ear.on(bench.topic("telemetry/load"))
        bench.host.trip(trip)
        await ear.until(lambda message: '"tripped"' in message.payload)
    output = (await status_of(bench)).output
    assert "  slow step   5 at " in output
    assert "  reference   3 V\n" in output
    assert "  set-point   0 V\n" in output
    assert f"  trip        {trip}\n  remedy      look for" in output
    bench.host.show(STANDBY)
    async with listening(bench.broker, bench.topic("state")) as ear:
        await ear.until(lambda message: '"standby"' in message.payload)
    output = (await status_of(bench)).output
    assert re.search(r"  last trip   \S+Z: over-voltage", output)


async def test_status_tells_programs_with_telemetry(bench: Bench) -> None:
    async with listening(bench.broker, bench.topic("telemetry/load")) as ear:
        bench.hub.publish(load_report(5))
        await ear.on(bench.topic("telemetry/load"))
    outcome = await status_of(bench, "--json")
    found = json.loads(outcome.output)
    assert (outcome.status, found["live"]) == (0, True)
    assert found["availability"] == "online"
    assert found["state"]["state"] == "standby"
    assert found["telemetry"]["load"]["k"] == 5
    assert found["telemetry"]["drive"]["ticks"] == 600


async def test_status_of_a_drive_that_left_is_not_shown_as_live(
    mosquitto: Broker, tmp_path: Path
) -> None:
    async with serving(mosquitto, "left", tmp_path):
        pass
    outcome = await adaptdrive("status", "left", *at(mosquitto))
    assert outcome.status == 3
    assert outcome.output.startswith("left is offline\n  last state")


def test_a_good_configuration_ends_with_0() -> None:
    outcome = here("check", str(EXAMPLE))
    assert (outcome.status, outcome.errors) == (0, "")


def test_a_bad_configuration_ends_with_2_and_every_flaw(tmp_path: Path) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    flawed = tmp_path / "flawed.toml"
    flawed.write_text("unknown_key = 1\n" + text + "\n[realtime]\nlate_fraction = 7\n")
    outcome = here("check", str(flawed))
    assert (outcome.status, outcome.output) == (2, "")
    lines = outcome.errors.splitlines()
    assert all(line.startswith(f"adaptdrive: {flawed}: ") for line in lines)
    assert any("unknown_key" in line for line in lines)
    assert any("realtime.late_fraction" in line for line in lines)


def test_a_configuration_without_an_end_ends_with_2() -> None:
    outcome = here("check", "/dev/zero")
    assert outcome.status == 2
    assert "more than" in outcome.errors


def test_a_check_for_programs_lists_limits_and_flaws(tmp_path: Path) -> None:
    outcome = here("check", "--json", str(EXAMPLE))
    report = json.loads(outcome.output)
    assert (outcome.status, outcome.errors) == (0, "")
    assert report["valid"]
    assert report["drive"] == "motor"
    assert report["output"] == {"name": "speed", "unit": "V"}
    stale = next(one for one in report["time_limits"] if "interlocks.stale_s" in one["keys"])
    assert stale["limit_s"] == tomllib.loads(EXAMPLE.read_text())["interlocks"]["stale_s"]
    flawed = tmp_path / "flawed.toml"
    flawed.write_text("unknown_key = 1\n" + EXAMPLE.read_text(encoding="utf-8"))
    outcome = here("check", "--json", str(flawed))
    report = json.loads(outcome.output)
    assert (outcome.status, report["valid"]) == (2, False)
    assert "unknown_key" in [one["place"] for one in report["flaws"]]


@pytest.mark.parametrize("verb", ["check", "run", "probe"])
def test_a_missing_configuration_ends_with_2(tmp_path: Path, verb: str) -> None:
    outcome = here(verb, str(tmp_path / "none.toml"))
    assert (outcome.status, outcome.output) == (2, "")
    assert "none.toml" in outcome.errors
    assert outcome.errors.count("\n") == 1


def test_a_missing_session_is_one_clear_line(tmp_path: Path) -> None:
    outcome = here("replay", str(tmp_path / "none"))
    assert (outcome.status, outcome.output) == (1, "")
    assert outcome.errors.startswith("adaptdrive: ")
    assert outcome.errors.count("\n") == 1


def test_the_schema_is_the_one_of_the_configuration() -> None:
    outcome = here("schema")
    assert outcome.status == 0
    assert json.loads(outcome.output) == Configuration.model_json_schema()


async def test_the_version() -> None:
    assert await adaptdrive("--version") == Outcome(0, f"{__version__} (pure Python)\n", "")


def test_help_names_every_command() -> None:
    outcome = here("--help")
    assert (outcome.status, outcome.errors) == (0, "")
    for command in ("run", "check", "schema", "probe", "replay", "status", "setpoint"):
        assert command in outcome.output


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


@pytest.mark.parametrize(
    "words",
    [
        "explode",
        "setpoint bench",
        "setpoint bench fast",
        "setpoint bench 3 4",
        "setpoint bench+ 3",
        "setpoint bench 3 --bogus 1",
        "setpoint bench 3 --broker host:99999",
        "setpoint bench 3 --timeout -1",
        "setpoint bench 3 --timeout nan",
        "setpoint bench 3 --timeout 1e15",
        "waveform bench square 3 3.2",
        "waveform bench off 1 2",
        "waveform bench saw 3 3.2 10",
        "mode bench wild",
        "check",
    ],
)
def test_wrong_words_end_with_2_and_one_line(words: str) -> None:
    outcome = here(*words.split())
    assert (outcome.status, outcome.output) == (2, "")
    assert outcome.errors.startswith("adaptdrive: ")
    assert outcome.errors.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("setpoint bench {}", "VALUE"),
        ("pole bench {}", "VALUE"),
        ("voltage bench {}", "VALUE"),
        ("voltage bench 280 --hold {}", "--hold"),
        ("waveform bench sine {} 3.2 60", "LOW"),
        ("waveform bench sine 3 {} 60", "HIGH"),
        ("waveform bench sine 3 3.2 {}", "PERIOD"),
    ],
)
@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_a_number_that_is_not_finite_is_refused_by_name(
    words: str, option: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.format(value).split()) == 2
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1
    assert option in errors
    assert value in errors


def test_an_integer_is_not_rounded(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["panel", "--no-open", "--port", "70000.5"]) == 2
    problem = 'Invalid value for --port: unable to convert "70000.5" into int.'
    assert capsys.readouterr().err == f"adaptdrive: {problem}\n"


async def test_an_interrupted_command_is_quiet(mosquitto: Broker) -> None:
    # A suite that runs in the background may have been told to ignore interrupts, and pass it on.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    async with listening(mosquitto, "adaptdrive/nobody/command/ping") as ear:
        process = await start("enable", "nobody", "--timeout", "60", *at(mosquitto))
        await ear.on("adaptdrive/nobody/command/ping")
    process.send_signal(signal.SIGINT)
    output, errors = await process.communicate()
    assert (process.returncode, output, errors) == (130, b"", b"")


UNWRITABLE = "standard output cannot be written: {}; the command itself ended with status 0"
EARLY = "standard output cannot be written: {}; the command ended early"

NO_READER = "| true; exit ${PIPESTATUS[0]}"
FULL, UNREADABLE = "No space left on device", "Bad file descriptor"
LIST = "adaptdrive.cli sessions list --json --directory ."
LONGER_THAN_THE_BUFFER = "adaptdrive.cli schema"
DEMO = "adaptdrive_sim demo bath --headless --duration 2"
HELPS = (
    "adaptdrive.cli",
    "adaptdrive.cli --help",
    "adaptdrive.cli sessions",
    "adaptdrive.cli run --help",
    "adaptdrive.cli --version",
    "adaptdrive_sim",
    "adaptdrive_sim --help",
    "adaptdrive_sim demo --help",
)


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(
    ("command", "status", "errors"),
    [
        *((f"{words} {NO_READER}", 0, "") for words in (LIST, DEMO, *HELPS)),
        (f"{LIST} >&-", 0, ""),
        (f"{LIST} <&- >&- 2>&-", 0, ""),
        (f"{LIST} >/dev/full", 1, f"adaptdrive: {UNWRITABLE.format(FULL)}\n"),
        (f"{LIST} 1</dev/null", 1, f"adaptdrive: {UNWRITABLE.format(UNREADABLE)}\n"),
        (f"{LONGER_THAN_THE_BUFFER} >/dev/full", 1, f"adaptdrive: {EARLY.format(FULL)}\n"),
        (f"{LONGER_THAN_THE_BUFFER} 1</dev/null", 1, f"adaptdrive: {EARLY.format(UNREADABLE)}\n"),
        (f"{DEMO} >&- 2>&-", 0, ""),
        (f"{DEMO} >/dev/full", 1, f"adaptdrive-sim: {UNWRITABLE.format(FULL)}\n"),
        ("adaptdrive_sim --help >/dev/full", 1, f"adaptdrive-sim: {EARLY.format(FULL)}\n"),
    ],
)
def test_output_that_nobody_takes_gives_no_traceback_and_no_false_status(
    tmp_path: Path, command: str, status: int, errors: str, unbuffered: str
) -> None:
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m {command}"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env=_environment() | {"PYTHONUNBUFFERED": unbuffered},
    )
    assert (done.returncode, done.stderr) == (status, errors)


@pytest.mark.parametrize("columns", ["0", "2", "19"])
@pytest.mark.parametrize("module", ["adaptdrive.cli", "adaptdrive_sim"])
def test_help_ends_in_a_terminal_of_few_columns(module: str, columns: str) -> None:
    words = [sys.executable, "-m", module, "--help"]
    environment = _environment() | {"COLUMNS": columns}
    done = subprocess.run(
        words, capture_output=True, text=True, check=False, env=environment, timeout=60.0
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("around", [{"PYTHONIOENCODING": "latin-1"}, C_LOCALE], ids=str)
def test_a_letter_that_the_terminal_does_not_have_is_escaped(around: dict[str, str]) -> None:
    example = Path(__file__).parents[2] / "deploy" / "examples" / "motor.toml"
    words = [sys.executable, "-m", "adaptdrive.cli", "check", str(example)]
    done = subprocess.run(words, capture_output=True, check=False, env=_environment() | around)
    assert (done.returncode, done.stderr) == (0, b"")
    assert rb"2.2\u20264.4 V" in done.stdout


@pytest.mark.parametrize("around", [{"PYTHONIOENCODING": "latin-1"}, C_LOCALE], ids=str)
def test_a_path_is_printed_with_its_own_bytes(around: dict[str, str], tmp_path: Path) -> None:
    """A script opens what a command has printed."""
    place = tmp_path / os.fsdecode(b"caf\xe9")
    place.mkdir()
    folder = os.fsencode(place)
    examples = Path(__file__).parents[2] / "deploy" / "examples"
    for name in ("motor.toml", "adaptdrive.dbc"):
        shutil.copy(examples / name, place)
    words: list[str | bytes] = [sys.executable, "-m", "adaptdrive.cli", "check"]
    words += [folder + b"/motor.toml"]
    done = subprocess.run(words, capture_output=True, check=False, env=_environment() | around)
    assert (done.returncode, done.stderr) == (0, b"")
    assert folder + b"/motor.toml: drive motor is" in done.stdout


@pytest.mark.parametrize(
    ("output", "problem"),
    [("/dev/full", "No space left on device"), ("a pipe", "Broken pipe")],
)
async def test_an_answer_that_cannot_be_printed_is_told_as_an_error(
    bench: Bench, output: str, problem: str
) -> None:
    if output == "a pipe":
        reading, writing = os.pipe()
        os.close(reading)
    else:
        writing = os.open(output, os.O_WRONLY)
    words = (sys.executable, "-m", "adaptdrive.cli", "enable", "bench", *at(bench.broker))
    process = await asyncio.create_subprocess_exec(
        *words, stdout=writing, stderr=asyncio.subprocess.PIPE, env=_environment()
    )
    os.close(writing)
    _, errors = await process.communicate()
    told = f"bench: enable accepted, running (standard output cannot be written: {problem})"
    assert (process.returncode, errors.decode()) == (0, f"adaptdrive: {told}\n")
    assert bench.host.asked == [Enable()]


@pytest.mark.parametrize(
    ("redirection", "errors"),
    [
        (">/dev/full", f"adaptdrive: {EARLY.format('No space left on device')}\n"),
        ("| true; exit ${PIPESTATUS[0]}", ""),
    ],
)
def test_a_probe_ends_with_its_reader(
    tmp_path: Path, free_udp_port: int, redirection: str, errors: str
) -> None:
    examples = Path(__file__).parents[2] / "deploy" / "examples"
    text = (examples / "motor.toml").read_text(encoding="utf-8")
    text = text.replace("udp_port = 43113", f"udp_port = {free_udp_port}")
    (tmp_path / "motor.toml").write_text(text, encoding="utf-8")
    shutil.copy(examples / "adaptdrive.dbc", tmp_path)
    command = f"{sys.executable} -m adaptdrive.cli probe {tmp_path / 'motor.toml'} {redirection}"
    done = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, check=False, timeout=120.0
    )
    assert (done.returncode, done.stderr) == (1, errors)


def test_a_reader_that_has_had_enough_is_no_error_to_complain_about() -> None:
    command = f"{sys.executable} -m adaptdrive.cli schema | head -n 1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
    assert done.stdout == "{\n"
    assert done.stderr == ""


@pytest.mark.parametrize("name", ["a\tb", 5000 * "a"])
def test_a_user_name_that_no_broker_knows_is_one_line(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert main(["list", "--username", name]) == 2
    assert "A user name has at most 4096 letters, all printable." in capsys.readouterr().err


def test_a_password_that_is_too_long_is_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(65_536 * b"a")
    assert main(["list", "--username", "a", "--password-file", str(secret)]) == 3
    assert str(secret) in capsys.readouterr().err


@pytest.mark.parametrize("words", [("--ca-file", "/etc/ca.pem"), ("--tls", "--ca-file", "x")])
def test_an_authority_without_tls_is_refused(words: tuple[str, ...]) -> None:
    outcome = here("disable", "bench", "--broker", "127.0.0.1:1", *words)
    refused = "--tls" not in words
    assert ("over the wire in clear" in outcome.errors) is refused
    assert outcome.status == (2 if refused else 3)


@pytest.mark.parametrize("host", ["a" * 64, "bad_-", "x..y", "tür" * 30])
def test_a_broker_that_cannot_be_looked_up_is_refused(host: str) -> None:
    outcome = here("disable", "bench", "--broker", host)
    assert "host name" in outcome.errors
    assert outcome.status == 2


@pytest.mark.parametrize(
    ("mistyped", "meant"),
    [
        ("comission", "commission"),
        ("setpiont", "setpoint"),
        ("lsit", "list"),
        ("voltge", "voltage"),
    ],
)
def test_an_unknown_command_gets_the_nearest_known_one(
    mistyped: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([mistyped, "motor", "3"]) == 2
    assert f"(did you mean {meant!r}?)" in capsys.readouterr().err


def test_a_name_that_no_drive_can_have_is_not_disturbed() -> None:
    words = [sys.executable, "-m", "adaptdrive_sim", "disturb", "motor+1", "add-disk"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=_environment())
    assert done.returncode == 2
    assert "The name of a drive has 1 to 64 letters" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_word_too_many_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "motor", "pump"]) == 2
    said = "adaptdrive: the command takes no 'motor pump'; see its --help\n"
    assert capsys.readouterr() == ("", said)


def test_a_configuration_whose_name_is_not_utf_8_is_checked_for_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / os.fsdecode(b"motor-\xff.toml")
    shutil.copy(EXAMPLE, file)
    shutil.copy(EXAMPLE.with_name("adaptdrive.dbc"), tmp_path)
    for name, status in ((file, 0), (tmp_path / os.fsdecode(b"\xff"), 2)):
        assert main(["check", "--json", str(name)]) == status
        assert json.loads(capsys.readouterr().out)["config"].startswith(str(tmp_path))
