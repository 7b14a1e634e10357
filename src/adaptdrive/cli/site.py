"""`adaptdrive list` and `watch`: all drives of a broker, and one of them live."""

from __future__ import annotations

import asyncio
import json
import sys
from dataclasses import asdict

from adaptdrive.cli.contact import Contact, DriveName
from adaptdrive.cli.display import site_table
from adaptdrive.cli.operate import ACCEPTED, NO_ANSWER, no_answer
from adaptdrive.cli.standard_files import UNUSABLE
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.listener import read_site

_HERE = Contact()


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
        return no_answer(problem)
    if contact.as_json:
        print(json.dumps({name: asdict(status) for name, status in found.items()}, indent=2))
    elif found:
        print(site_table(found))
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
    from adaptdrive.watch.main import watch as watch_drive  # noqa: PLC0415 - it is large
    from adaptdrive.watch.terminal import refuse_dumb_terminal  # noqa: PLC0415

    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        print("adaptdrive: watch needs a terminal; in a pipe use status --json", file=sys.stderr)
        return UNUSABLE
    refuse_dumb_terminal()
    answered = asyncio.run(watch_drive(contact.settings, drive, contact.timeout))
    return ACCEPTED if answered else NO_ANSWER
