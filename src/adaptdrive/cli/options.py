"""Options that several commands have: broker, login, form of the output; what they refuse."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
from cyclopts import Parameter, Token, convert

from adaptdrive.config.services import Mqtt, check_host
from adaptdrive.util.errors import ConfigurationError, Flaw
from adaptdrive.util.files import directory_flaw

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


def _read_integer(_: object, tokens: Sequence[Token]) -> int:
    """Read an integer; cyclopts alone rounds a fraction without a word."""
    text = tokens[0].value
    if text.partition(".")[2].strip("0"):
        raise ValueError(f'unable to convert "{text}" into int.')
    number: int = convert(int, tokens)
    return number


Flag = Annotated[bool, Parameter(negative=())]
Json = Annotated[bool, Parameter(name="--json", negative=())]
Settings = Annotated[tuple[str, ...], Parameter(name="--set", negative=())]
_FINITE = refusing(math.isfinite, "A finite number is needed.")
Number = Annotated[float, Parameter(validator=_FINITE)]
Second = Annotated[float | None, Parameter(validator=_FINITE)]
Integer = Annotated[int, Parameter(converter=_read_integer)]


def print_json(content: object) -> None:
    """Print something as JSON, for programs."""
    print(msgspec.json.format(msgspec.json.encode(content)).decode())


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
    if (flaw := directory_flaw(folder)) is not None:
        raise ConfigurationError("--into", [Flaw(str(folder), f"cannot be written: {flaw}")])


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
    match = _ADDRESS.fullmatch(text)
    number = int(match["port"] or port) if match is not None else 0
    if match is None or not 1 <= number <= _HIGHEST_PORT:
        raise ValueError("A broker is given as HOST or HOST:PORT.")
    return check_host(match["host"].strip("[]")), number


def _check_address(_: object, text: str | None) -> None:
    if text is not None:
        read_address(text)


_check_drive = refusing(
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


def _configured(path: Path) -> Mqtt:
    from adaptdrive.config.file import load_configuration  # noqa: PLC0415 - few commands need it

    return load_configuration(path).mqtt


DriveName = Annotated[str, Parameter(validator=_check_drive)]


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
    def settings(self) -> Mqtt:
        """The broker, in the words of the configuration.

        Raises:
            ConfigurationError: The configuration cannot be used.
        """
        known = Mqtt() if self.config is None else _configured(self.config)
        tls = self.tls or (known.tls and self.broker is None)
        host, port = known.host, known.port
        if self.broker is not None:
            host, port = read_address(self.broker, _TLS_PORT if tls else _PORT)
        elif self.config is None and tls:
            port = _TLS_PORT
        return Mqtt(
            host=host,
            port=port,
            tls=tls,
            ca_file=self.ca_file or (known.ca_file if tls else None),
            username=self.username,
            password_file=self.password_file,
        )
