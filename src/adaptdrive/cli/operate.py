"""Operator commands: all drives of a broker, and one drive that is asked over MQTT.

They return 0 when the drive accepted, 1 when it refused, 3 when there was no answer.
"""

import asyncio
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Literal

from msgspec.structs import asdict as asdict_of

from adaptdrive.cli import UNUSABLE, discard_output, display, print_error
from adaptdrive.cli.explain import with_kind
from adaptdrive.cli.options import Contact, DriveName, Level, Number, Typed, needing
from adaptdrive.cli.programs import Slope, read_program
from adaptdrive.mqtt.client import (
    NoAnswerError,
    read_display,
    read_site,
    read_status,
    send_command,
)
from adaptdrive.safety.trips import kind_of, remedy

ACCEPTED, REFUSED, NO_ANSWER = 0, 1, 3
_HERE = Contact()
_SHELL = "drive.<Tab> lists values and commands; drive.setpoint(VALUE); drive.enable(); exit leaves"


def setpoint(
    drive: DriveName,
    value: Level,
    /,
    *,
    ramp: Slope | None = None,
    contact: Contact = _HERE,
) -> int:
    """Hold a constant set-point.

    Args:
        drive: Name of the drive.
        value: Set-point in the unit that `status` shows, or with a unit, such as 1500rpm.
        ramp: Slope of the way there, such as 2/s, 1.5/min or 20/h; that of the configuration when
            left out.
        contact: Broker.
    """
    return _ask_level(drive, "setpoint", value, (value, ramp), contact, slope=ramp)


def waveform(  # noqa: PLR0913 - the words of the command line
    drive: DriveName,
    shape: Literal["square", "sine", "triangle", "off"],
    low: Level | None = None,
    high: Level | None = None,
    period: Number | None = None,
    /,
    *,
    preview: bool = True,
    contact: Contact = _HERE,
) -> int:
    """Follow a periodic set-point, or stop following it.

    Args:
        drive: Name of the drive.
        shape: Form of one period; `off` holds the present set-point.
        low: Lowest value, as a set-point.
        high: Highest value, as a set-point.
        period: Length of one period in seconds.
        preview: Whether adaptive control moves before an edge that V_c could not follow.
        contact: Broker.
    """
    numbers = {"low": low, "high": high, "period_s": period}
    if shape == "off":
        if any(number is not None for number in numbers.values()):
            return print_error("adaptdrive", "waveform off takes no values", UNUSABLE)
        return _ask(drive, "waveform", None, contact)
    if None in numbers.values():
        missing = f"waveform {shape} needs LOW, HIGH and PERIOD"
        return print_error("adaptdrive", missing, UNUSABLE)
    value = {"shape": shape, **numbers}
    return _ask_level(drive, "waveform", value, (low, high), contact, preview=preview)


def program(
    action: Literal["start", "pause", "resume", "skip", "stop"],
    drive: DriveName,
    file: Path | None = None,
    /,
    *,
    contact: Contact = _HERE,
) -> int:
    """Run a program of set-points; pause, resume or stop it, or skip a step.

    Args:
        action: What becomes of it.
        drive: Name of the drive.
        file: The program to start, as TOML.
        contact: Broker.
    """
    if (action == "start") is (file is None):
        needed = "needs a FILE" if file is None else "takes no FILE"
        return print_error("adaptdrive", f"program {action} {needed}", UNUSABLE)
    if file is None:
        return _ask(drive, "program", action, contact)
    program = read_program(file)
    if program["unit"] is not None:
        return _ask(drive, "program", program, contact)
    return _ask_level(drive, "program", program, (), contact)


def pole(drive: DriveName, value: Number, /, *, contact: Contact = _HERE) -> int:
    """Choose the closed-loop pole of the load loop.

    Args:
        drive: Name of the drive.
        value: Pole in the z-plane of the slow rate, between 0 (fast) and 1 (slow).
        contact: Broker.
    """
    return _ask(drive, "pole", value, contact)


def mode(
    drive: DriveName, value: Literal["fixed", "adaptive", "manual"], /, *, contact: Contact = _HERE
) -> int:
    """Choose the fixed or the adaptive controller, or manual.

    Args:
        drive: Name of the drive.
        value: The controller, or manual.
        contact: Broker.
    """
    return _ask(drive, "mode", value, contact)


def manual(drive: DriveName, /, *, contact: Contact = _HERE) -> int:
    """Hold the present V_c until the command voltage.

    Args:
        drive: Name of the drive.
        contact: Broker.
    """
    return _ask(drive, "mode", "manual", contact)


def voltage(
    drive: DriveName, value: Number, /, *, hold: Number | None = None, contact: Contact = _HERE
) -> int:
    """Set V_c in mode manual.

    Args:
        drive: Name of the drive.
        value: V_c in volts.
        hold: Longest time in seconds to the next voltage; the drive trips when it passes.
        contact: Broker.
    """
    return _ask(drive, "voltage", value, contact, hold_s=hold)


def enable(drive: DriveName, /, *, contact: Contact = _HERE) -> int:
    """Energise the drive and hold the present output.

    Args:
        drive: Name of the drive.
        contact: Broker.
    """
    return _ask(drive, "enable", None, contact)


def disable(drive: DriveName, /, *, contact: Contact = _HERE) -> int:
    """Bring the drive into its safe state.

    Args:
        drive: Name of the drive.
        contact: Broker.
    """
    return _ask(drive, "disable", None, contact)


def reset(drive: DriveName, /, *, contact: Contact = _HERE) -> int:
    """Leave a trip whose cause is gone.

    Args:
        drive: Name of the drive.
        contact: Broker.
    """
    return _ask(drive, "reset", None, contact)


def reload(drive: DriveName, /, *, measured: Path | None = None, contact: Contact = _HERE) -> int:
    """Take the load and the limits of the file, between two runs.

    Args:
        drive: Name of the drive, which is in standby.
        measured: The daemon's file, whose model was measured: the estimates start from it. A
            daemon with another file refuses.
        contact: Broker.
    """
    from adaptdrive.config.file import digest_of, read_text  # noqa: PLC0415 - few commands need it

    digest = None if measured is None else digest_of(read_text(measured))
    return _ask(drive, "reload", None, contact, measured=digest)


def status(drive: DriveName, /, *, contact: Contact = _HERE) -> int:
    """Show the state and the telemetry of a drive.

    Args:
        drive: Name of the drive.
        contact: Broker.

    Returns:
        0 when the daemon is online and publishes telemetry, 3 when it does not.
    """
    try:
        found = asyncio.run(read_status(contact.settings, drive, contact.timeout))
    except NoAnswerError as problem:
        return print_error("adaptdrive", str(problem), NO_ANSWER)
    as_json = contact.as_json
    print(json.dumps(asdict(found), indent=2) if as_json else display.describe(drive, found))
    return ACCEPTED if found.online and found.live else NO_ANSWER


def _ask_level(
    drive: str,
    verb: str,
    value: object,
    levels: Sequence[Typed | None],
    contact: Contact,
    **fields: object,
) -> int:
    """Send a command in the unit that was typed, else in that in which the drive is shown."""
    units = {one.unit for one in levels if one is not None and one.unit}
    if len(units) > 1:
        return print_error("adaptdrive", f"{verb} in {' and '.join(sorted(units))}", UNUSABLE)
    if not (unit := units.pop() if units else None):
        try:
            reading = read_display(contact.settings, drive, contact.timeout)
            unit = asyncio.run(reading).mark
        except NoAnswerError as problem:
            return print_error("adaptdrive", str(problem), NO_ANSWER)
    if isinstance(value, dict) and verb == "program":
        return _ask(drive, verb, value | {"unit": unit}, contact, **fields)
    return _ask(drive, verb, value, contact, unit=unit, **fields)


def _ask(drive: str, verb: str, value: object, contact: Contact, **fields: object) -> int:
    try:
        sending = send_command(contact.settings, drive, verb, value, contact.timeout, **fields)
        reply = asyncio.run(sending)
    except NoAnswerError as problem:
        return print_error("adaptdrive", str(problem), NO_ANSWER)
    if contact.as_json:
        _print_answer(json.dumps(asdict_of(reply)))
        return ACCEPTED if reply.accepted else REFUSED
    if reply.accepted:
        _print_answer(f"{drive}: {verb} accepted, {reply.state}")
        return ACCEPTED
    advice = with_kind(remedy(kind_of(reply.trip_kind)), reply.trip_kind)
    steps = f"\nwhat to do: {advice}" if advice else ""
    return print_error("adaptdrive", f"{drive} refused {verb}: {reply.reason}{steps}", REFUSED)


def _print_answer(answer: str) -> None:
    """Print what a drive has answered, on standard error where standard output takes nothing."""
    try:
        print(answer, flush=True)
    except OSError as problem:
        discard_output()
        unwritable = f"standard output cannot be written: {problem.strerror}"
        print(f"adaptdrive: {answer} ({unwritable})", file=sys.stderr)


def list_drives(*, contact: Contact = _HERE) -> int:
    """List the drives that have published to the broker, with state, output and trip.

    Args:
        contact: Broker.

    Returns:
        0 when there is a drive, 3 when there is none or the broker cannot be reached.
    """
    try:
        found = asyncio.run(read_site(contact.settings, contact.timeout))
    except NoAnswerError as problem:
        return print_error("adaptdrive", str(problem), NO_ANSWER)
    if contact.as_json:
        print(json.dumps({name: asdict(status) for name, status in found.items()}, indent=2))
    elif found:
        print(display.site_table(found))
    else:
        broker = contact.settings
        print(f"adaptdrive: no drive is on {broker.host}:{broker.port}", file=sys.stderr)
    return ACCEPTED if found else NO_ANSWER


def watch(drive: DriveName, /, *, contact: Contact = _HERE) -> int:
    """Show a drive live in the terminal, with keys for the commands.

    Args:
        drive: Name of the drive.
        contact: Broker.

    Returns:
        0, or 3 when a command was under way at the end and is not known to be carried out.
    """
    from adaptdrive.tui import watch as watch_drive  # noqa: PLC0415 - it is large
    from adaptdrive.tui.terminal import refuse_dumb_terminal  # noqa: PLC0415

    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        needed = "watch needs a terminal; in a pipe use status --json"
        return print_error("adaptdrive", needed, UNUSABLE)
    refuse_dumb_terminal()
    answered = asyncio.run(watch_drive(contact.settings, drive, contact.timeout))
    return ACCEPTED if answered else NO_ANSWER


def shell(drive: DriveName, /, *, contact: Contact = _HERE) -> int:
    """Open a drive in IPython, as `drive`; to leave it changes nothing on the drive.

    Args:
        drive: Name of the drive.
        contact: Broker.

    Returns:
        0, or 3 when the drive does not answer.
    """
    with needing("shell"):
        from IPython import start_ipython  # noqa: PLC0415 - an extra
    from adaptdrive import lab  # noqa: PLC0415 - no other command needs it

    try:
        connected = lab.connect(drive, contact.settings, contact.timeout)
    except NoAnswerError as problem:
        return print_error("adaptdrive", str(problem), NO_ANSWER)
    with connected:
        print(f"{connected!r}\n{_SHELL}")
        # a refusal is no error of the program
        argv = ["--no-banner", "--InteractiveShell.xmode=Minimal"]
        start_ipython(argv=argv, user_ns={"drive": connected, "lab": lab})
    return ACCEPTED
