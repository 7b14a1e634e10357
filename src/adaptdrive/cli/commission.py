"""The guided experiment on an unknown load."""

from __future__ import annotations

import asyncio
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from adaptdrive.cli.options import Contact, DriveName, Flag, extra, refuse_unwritable
from adaptdrive.util.errors import ConfigurationError, Flaw
from adaptdrive.util.files import replace_result

if TYPE_CHECKING:
    from adaptdrive.commissioning.report import Commissioned

_HERE = Contact()
_PLACES = (Path(), Path("/etc/adaptdrive"))
_STANDBY_S = 5.0
_LARGEST_MOVE = 30.0


def _check_move(_: object, move: float) -> None:
    if not 0.0 < move <= _LARGEST_MOVE:
        raise ValueError(f"A movement is above 0 and at most {_LARGEST_MOVE:g} percent.")


def _check_patience(_: object, patience: float | None) -> None:
    if patience is not None and not 1.0 <= patience <= 86_400.0:
        raise ValueError("A wait is 1 to 86400 seconds.")


def commission(  # noqa: PLR0913 - the words of the command line
    drive: DriveName,
    /,
    *,
    config: Path | None = None,
    move: Annotated[float, Parameter(validator=_check_move)] = 5.0,
    patience: Annotated[float | None, Parameter(validator=_check_patience)] = None,
    into: Path = Path(),
    write: Flag = False,
    apply: Flag = False,
    yes: Flag = False,
    contact: Contact = _HERE,
) -> int:
    """Measure an unknown load on its drive, propose the settings, and put them to use.

    On a terminal it asks at the end whether to apply them.

    Args:
        drive: Name of the drive, whose daemon runs and is in standby.
        config: Its configuration; DRIVE.toml here or in /etc/adaptdrive when left out.
        move: Movement of the output in percent of the set-point range.
        patience: Shortest wait in seconds for the load to respond; by the kind of load when left
            out.
        into: Folder for commission.png; it is made where it is missing.
        write: Write the settings to the configuration; the old file is kept next to it.
        apply: Write the settings, have the daemon take them, and continue in mode adaptive.
        yes: Begin without a question.
        contact: Broker.
    """
    path = _configuration(drive, config)
    with extra("analysis"):
        from adaptdrive.commissioning import file, report, run  # noqa: PLC0415 - it is large
    wanted = run.CommissionRequest(path, move / 100.0, patience, _STANDBY_S)
    if not yes and not _agreed(run.announcement(wanted, drive)):
        return 1
    refuse_unwritable(into)
    contact = replace(contact, config=path)
    with run.alone(drive, contact.settings):
        if write or apply:
            file.refuse_unwritable(path)
        commissioned = asyncio.run(run.commission(wanted, drive, contact.settings, contact.timeout))
        print(report.as_text(commissioned))
        figure = into / "commission.png"
        replace_result(figure, report.draw(commissioned))
        print(f"\n{figure}")
        if commissioned.refusal and not (write or apply):
            return 0
        digest = _write(path, commissioned) if write or apply else ""
        if apply or (not write and _agreed_to("\napply and go on in adaptive? [y/N] ")):
            digest = digest or _write(path, commissioned)
            _put_to_use(drive, commissioned, digest, contact)
        else:
            _say_next(drive, run.reached(commissioned), path if write else None)
    return 0


def _write(path: Path, commissioned: Commissioned) -> str:
    """Write the settings; return the digest of the file."""
    from adaptdrive.commissioning.run import write  # noqa: PLC0415 - it is large

    backup, digest = write(path, commissioned)
    print(f"\n{path} is written, the old file is {backup}")
    return digest


def _put_to_use(drive: str, commissioned: Commissioned, digest: str, contact: Contact) -> None:
    from adaptdrive.commissioning.file import put_to_use  # noqa: PLC0415 - it is large
    from adaptdrive.commissioning.run import reached  # noqa: PLC0415

    setpoint, unit = reached(commissioned), commissioned.before.load.output_unit
    waited_s = asyncio.run(put_to_use(contact.settings, drive, digest, setpoint, contact.timeout))
    print(
        f"{drive} holds {setpoint:.4g} {unit} in mode adaptive, in force after {waited_s:.1f} s\n\n"
        f"next:\n  adaptdrive setpoint {drive} VALUE\n  adaptdrive watch {drive}\n"
        f"  adaptdrive disable {drive}"
    )


def _say_next(drive: str, setpoint: float, written: Path | None) -> None:
    if written is None:
        print(f"\nnext: adaptdrive commission {drive} --apply, or copy the values by hand")
        return
    print(
        f"\nnext:\n  adaptdrive reload {drive} --measured {written}\n"
        f"  adaptdrive mode {drive} adaptive\n  adaptdrive enable {drive}\n"
        f"  adaptdrive setpoint {drive} {setpoint:.4g}"
    )


def _configuration(drive: str, config: Path | None) -> Path:
    """Return the configuration of a drive."""
    found = [place / f"{drive}.toml" for place in _PLACES] if config is None else [config]
    for path in found:
        if path.is_file():
            return path
    raise ConfigurationError(found[0], [Flaw("file", "is not there; name one with --config")])


def _agreed(announcement: str) -> bool:
    """Return whether the operator agrees; without a terminal nothing is asked."""
    print(announcement)
    if not sys.stdin.isatty():
        print("adaptdrive: say --yes to begin", file=sys.stderr)
    return _agreed_to("begin? [y/N] ")


def _agreed_to(question: str) -> bool:
    """Return whether the operator agrees; a pipe does not."""
    if not sys.stdin.isatty():
        return False
    try:
        answer = input(question)
    except EOFError:
        print()
        return False
    return answer.strip().lower() in {"y", "yes"}
