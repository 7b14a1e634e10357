"""The words of a command line: the commands that they name, and options that several have."""

from __future__ import annotations

import math
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cyclopts
import msgspec
from cyclopts import App, Parameter

from adaptdrive.cli import UNUSABLE, print_error, version
from adaptdrive.runtime.requests import REQUESTS
from adaptdrive.util.errors import ConfigurationError, nearest

if TYPE_CHECKING:  # no command needs it for its help
    from adaptdrive.mqtt.connection import Broker

# The commands.

_COMMANDS = {
    "init": (".configuration", "Write a first configuration for a load and a bus."),
    "start": (".desk", "Run a drive on a desk: its daemon, a broker, the panel, and the view."),
    "run": ("", "Run the daemon for one drive until a signal stops it."),
    "check": (".configuration", "Validate a configuration; list every error with its place."),
    "schema": (".configuration", "Print the JSON Schema of the configuration, for editors."),
    "probe": (".probe", "Show decoded measurements from the bus; command nothing."),
    "explain": (".explain", "Explain a kind of trip: its cause, and what ends it; or list all."),
    "replay": (".sessions", "Run the controller again on a recorded session."),
    "events": (".sessions", "Show the events of a recorded session."),
    "plot": (".analysis", "Draw a recorded session: a figure, and a report as one HTML file."),
    "identify": (".analysis", "Identify the load from a session or a CSV file, with error bars."),
    "whatif": (".analysis", "Run a session again in closed loop with other settings."),
    "health": (".sessions", "Show the load of a drive over the weeks: trend, changes, meaning."),
    "export": (
        ".analysis",
        "Write a session as CSV, Parquet, MATLAB, MDF 4 or MCAP, or its model.",
    ),
    "commission": (".analysis", "Measure an unknown load on its drive, and propose the settings."),
    "panel": (".desk", "Serve the panel, a web page for a broker's drives, on this machine."),
    "watch": (".operate", "Show a drive live in the terminal, with keys for the commands."),
    "shell": (".operate", "Open a drive in IPython: its values and its commands by name."),
    "status": (".operate", "Show the state and the telemetry of a drive."),
    "manual": (".operate", "Hold the present V_c until the command voltage."),
}

# Where an argument may be left out: cyclopts calls it [ARGS] in the first line of --help.
_ARGUMENTS = {
    "start": "[CONFIG]",
    "explain": "[KIND]",
    "waveform": "DRIVE SHAPE [LOW HIGH PERIOD]",
    "program": "ACTION DRIVE [FILE]",
} | dict.fromkeys(("replay", "events", "plot", "identify", "whatif"), "[SESSION]")

_LIST = "List the drives of a broker."
_SESSIONS = "List, show, verify and prune recorded sessions."


def parsed_command(app: App, words: Sequence[str] | None = None) -> Callable[[], object]:
    """Return what carries out the command that the words name, or prints why they name none.

    Args:
        app: The commands of a program.
        words: Words after its name; those of this process when None.
    """

    def carry_out() -> object:
        try:
            return app(words)
        except cyclopts.CycloptsError as problem:
            program = app.name[0]
            return print_error(program, _usage_error(program, problem), UNUSABLE)

    return carry_out


def _usage_error(program: str, problem: cyclopts.CycloptsError) -> str:
    """Return why the words name no command that can be carried out."""
    words = " ".join(problem.unused_tokens or ())
    if isinstance(problem, cyclopts.UnknownCommandError):
        hint = nearest(words.split(" ")[0], [*_COMMANDS, *REQUESTS, "list", "sessions"])
        return f"unknown command {words!r}{hint}; see {program} --help"
    if isinstance(problem, cyclopts.UnusedCliTokensError):
        return f"the command takes no {words!r}; see its --help"
    return " ".join(str(problem).split())


def build_app() -> App:
    """Return the commands of `adaptdrive`."""
    app = App(
        name="adaptdrive",
        help="Adaptive control of speed, temperature and charge behind a power-electronic drive.",
        version=version,
        print_error=False,
        exit_on_error=False,
        suppress_keyboard_interrupt=False,
        result_action="return_value",
    )
    for name, (module, purpose) in _COMMANDS.items():
        # By name, so that a command imports what it needs and no other command does.
        path = f"adaptdrive.cli{module}:{name}"
        app.command(path, name=name, help=purpose, usage=_usage(name))
    for verb, request in REQUESTS.items():
        path = f"adaptdrive.cli.operate:{verb}"
        purpose = (request.__doc__ or "").partition("\n")[0]
        app.command(path, name=verb, help=purpose, usage=_usage(verb))
    app.command("adaptdrive.cli.operate:list_drives", name="list", help=_LIST)
    app.command("adaptdrive.cli.sessions:app", name="sessions", help=_SESSIONS)
    app.register_install_completion_command(
        add_to_startup=False, help="Install completion for the present shell."
    )
    return app


def _usage(command: str) -> str | None:
    arguments = _ARGUMENTS.get(command)
    return arguments and f"Usage: adaptdrive {command} [OPTIONS] {arguments}"


# Options that several commands have, what they refuse, and the form of what they print.


def refusing(is_valid: Callable[[Any], bool], rule: str) -> Callable[[object, Any], None]:
    """Return the check of an option that may be left out.

    Args:
        is_valid: Whether a value may be used.
        rule: What is printed where it may not.
    """

    def check(_: object, value: object) -> None:
        if value is not None and not is_valid(value):
            raise ValueError(rule)

    return check


def _read_integer(_: object, tokens: Sequence[cyclopts.Token]) -> int:
    """Read an integer; cyclopts alone rounds a fraction without a word."""
    text = tokens[0].value
    if text.partition(".")[2].strip("0"):
        raise ValueError(f'unable to convert "{text}" into int.')
    number: int = cyclopts.convert(int, tokens)
    return number


class Typed(float):
    """A number as it was typed, and its unit.

    Attributes:
        unit: The unit, empty where none was typed.
    """

    unit: str = ""


_TYPED = re.compile(r"\s*(?>([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?))\s*(\D\S*)\s*")


def typed(text: str) -> Typed:
    """Return the number of a text such as `150`, `1500rpm` or `"60 °C"`.

    Raises:
        ValueError: It has none.
    """
    found = _TYPED.fullmatch(text)
    try:
        number = Typed(found[1] if found else text)
    except ValueError:
        raise ValueError(f'"{text}" is not a number, such as 150 or 1500rpm.') from None
    number.unit = found[2] if found else ""
    return number


def _read_typed(_: object, tokens: Sequence[cyclopts.Token]) -> Typed:
    return typed(tokens[0].value)


Flag = Annotated[bool, Parameter(negative=())]
Json = Annotated[bool, Parameter(name="--json", negative=())]
Settings = Annotated[tuple[str, ...], Parameter(name="--set", negative=())]
_FINITE = refusing(math.isfinite, "A finite number is needed.")
Number = Annotated[float, Parameter(validator=_FINITE)]
Second = Annotated[float | None, Parameter(validator=_FINITE)]
Level = Annotated[Typed, Parameter(converter=_read_typed, validator=_FINITE)]
Integer = Annotated[int, Parameter(converter=_read_integer)]


def print_json(content: object) -> None:
    """Print something as JSON, for programs; numbers that are not finite are null."""
    # what is of no type of JSON is a number of numpy
    print(msgspec.json.format(msgspec.json.encode(content, enc_hook=float)).decode())


def print_each(found: Iterable[tuple[str, object]], as_json: bool) -> int:
    """Print the line of each thing as it comes, or a list of the contents as JSON at the end.

    Args:
        found: Line and content of each.
        as_json: Print JSON, for programs.

    Returns:
        How many there are.
    """
    contents = []
    for line, content in found:
        contents.append(content)
        if not as_json:
            print(line)
    if as_json:
        print_json(contents)
    return len(contents)


@contextmanager
def needing(name: str) -> Iterator[None]:
    """End the command where a library is missing that belongs to an extra of the package.

    Args:
        name: The extra.
    """
    try:
        yield
    except ModuleNotFoundError as problem:
        advice = f"{problem.name} is missing: pip install 'adaptdrive[{name}]'"
        sys.exit(f"adaptdrive: {advice}")


def refuse_unwritable(folder: Path) -> None:
    """Refuse a folder that takes no file, before anything long is begun; make a missing one.

    Args:
        folder: The folder that the result goes to.

    Raises:
        ConfigurationError: It cannot be made or written.
    """
    from adaptdrive.util.files import directory_flaw  # noqa: PLC0415 - few commands need it

    if (flaw := directory_flaw(folder)) is not None:
        raise ConfigurationError.of("--into", str(folder), f"cannot be written: {flaw}")


# Options of all operator commands: address of the broker, login, form of the output.

_ADDRESS = re.compile(r"(?P<host>\[[^\]]+\]|[^:\[\]/\s]+)(:(?P<port>\d{1,5}))?")
_DRIVE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,63}")
_LONGEST_WAIT_S = 86_400.0
_LONGEST_USER = 4096
_PORT, _TLS_PORT, _HIGHEST_PORT = 1883, 8883, 65535


def read_address(text: str, port: int = _PORT) -> tuple[str, int]:
    """Return host and port of a broker.

    Args:
        text: HOST or HOST:PORT; an IPv6 address stands in brackets.
        port: The port where none is named.

    Raises:
        ValueError: It is no such thing.
    """
    from adaptdrive.util.clock import check_host  # noqa: PLC0415 - few commands need it

    match = _ADDRESS.fullmatch(text)
    number = int(match["port"] or port) if match is not None else 0
    if match is None or not 1 <= number <= _HIGHEST_PORT:
        raise ValueError("A broker is given as HOST or HOST:PORT.")
    return check_host(match["host"].strip("[]")), number


def _check_address(_: object, text: str | None) -> None:
    if text is not None:
        read_address(text)


check_drive = refusing(
    lambda name: _DRIVE.fullmatch(name) is not None,
    "The name of a drive has 1 to 64 letters, digits, '-' and '_', no '-' first.",
)
_check_timeout = refusing(
    lambda timeout: 0.0 < timeout <= _LONGEST_WAIT_S,
    f"A timeout is above 0 and at most {_LONGEST_WAIT_S:g} seconds.",
)
_check_user = refusing(
    lambda name: len(name) <= _LONGEST_USER and name.isprintable(),
    f"A user name has at most {_LONGEST_USER} letters, all printable.",
)


def _check_authority(_: object, contact: Contact | None) -> None:
    if contact is not None and contact.ca_file is not None and not contact.tls:
        raise ValueError(
            "--ca-file (ADAPTDRIVE_CA_FILE) without --tls (ADAPTDRIVE_TLS): the password would go "
            "over the wire in clear; add --tls."
        )


DriveName = Annotated[str, Parameter(validator=check_drive)]


@Parameter(name="*", validator=_check_authority)
@dataclass(frozen=True, slots=True)
class Contact:
    """Address of the broker, time-out and form of the output.

    Each option of the broker and the login also comes from the environment.

    Attributes:
        broker: Broker as HOST or HOST:PORT; 127.0.0.1:1883 when left out.
        config: Configuration of a daemon, whose broker, `tls` and `ca_file` are used where these
            options leave them out; its user, the drive, is not used.
        timeout: Seconds to wait for the answer.
        as_json: Print JSON.
        username: User name at the broker.
        password_file: File that holds the password.
        tls: Encrypt by TLS.
        ca_file: Certificate authority for TLS.
    """

    broker: Annotated[
        str | None, Parameter(validator=_check_address, env_var="ADAPTDRIVE_BROKER")
    ] = None
    config: Path | None = None
    timeout: Annotated[float, Parameter(validator=_check_timeout)] = 5.0
    username: Annotated[
        str | None, Parameter(validator=_check_user, env_var="ADAPTDRIVE_USERNAME")
    ] = None
    password_file: Annotated[Path | None, Parameter(env_var="ADAPTDRIVE_PASSWORD_FILE")] = None
    tls: Annotated[bool, Parameter(env_var="ADAPTDRIVE_TLS")] = False
    ca_file: Annotated[Path | None, Parameter(env_var="ADAPTDRIVE_CA_FILE")] = None
    as_json: Json = False

    @property
    def settings(self) -> Broker:
        """The broker, and the login there.

        Raises:
            ConfigurationError: The configuration has no broker that can be used.
        """
        from adaptdrive.mqtt.connection import Broker  # noqa: PLC0415 - `--help` needs none

        known = Broker() if self.config is None else _broker_in(self.config)
        tls = self.tls or (known.tls and self.broker is None)
        host, port = known.host, known.port
        if self.broker is not None:
            host, port = read_address(self.broker, _TLS_PORT if tls else _PORT)
        elif self.config is None and tls:
            port = _TLS_PORT
        ca_file = self.ca_file or (known.ca_file if tls else None)
        return Broker(host, port, tls, ca_file, self.username, self.password_file)


_MQTT_KEYS = frozenset({"host", "port", "tls", "ca_file"})


def _broker_in(path: Path) -> Broker:
    """Return the broker in the section `[mqtt]` of a configuration, without its login.

    The other sections are not looked at: a stop needs none of them.

    Raises:
        ConfigurationError: The file cannot be read, or the section not be used.
    """
    from adaptdrive.mqtt.connection import Broker  # noqa: PLC0415 - `--help` needs none
    from adaptdrive.util.files import read_regular  # noqa: PLC0415 - few commands need it

    with suppress(OSError, ValueError, TypeError, AttributeError):
        table = tomllib.loads(read_regular(path).decode("utf-8-sig")).get("mqtt", {})
        found = Broker(**{key: table[key] for key in _MQTT_KEYS & table.keys()})
        host = f"[{found.host}]" if ":" in found.host else found.host
        read_address(f"{host}:{found.port}")
        if (type(found.port), type(found.tls)) == (int, bool):
            return replace(found, ca_file=found.ca_file and path.parent / found.ca_file)
    from adaptdrive.config.file import load_configuration  # noqa: PLC0415 - few commands need it
    from adaptdrive.mqtt.service import broker_of  # noqa: PLC0415 - as above

    return broker_of(load_configuration(path).mqtt)  # raises what is wrong, with its place
