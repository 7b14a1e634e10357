"""Commands on a configuration: `init` writes a first one, `check` and `schema` read it."""

import json
import math
import os
import shlex
import sys
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from adaptdrive.app import starter
from adaptdrive.app.check_report import flawed_report, sound_report, tables
from adaptdrive.app.examine import advice, examine_text, load_examined
from adaptdrive.cli import UNUSABLE
from adaptdrive.cli.options import Flag, Json, check_drive, print_json
from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanLink
from adaptdrive.config.file import find_flaws, read_text
from adaptdrive.config.load import LoadName
from adaptdrive.devices import description
from adaptdrive.util.errors import ConfigurationError
from adaptdrive.util.files import replace_regular

_SHOWN = 3
_NODE_ID = 1
_TARGET_TORQUE = "0x6071"
_OF_THE_PROFILE = ("counter", "fault", "bridge", "command.bridge", "command.current_scale_S")
"""Names that a CiA 402 drive needs no entry for, or that it does not take."""


def init(  # noqa: PLR0913 - one parameter for each option
    load: LoadName,
    /,
    *,
    bus: starter.BusName | None = None,
    device: str | None = None,
    name: Annotated[str | None, Parameter(validator=check_drive)] = None,
    directory: Path = Path(),
    dbc: Path | None = None,
    eds: Path | None = None,
    yes: Flag = False,
) -> int:
    """Write a commented configuration that passes `check`, and name the next commands.

    With a DBC or EDS file its signals are proposed by name and unit; on a terminal each is asked
    for, elsewhere the likeliest is taken.

    Args:
        load: Kind of load.
        bus: Kind of bus.
        device: Described device that is nearest to yours, in place of the bus: the best beginning
            (docs/own-drive.md). Without both, all are listed.
        name: Name of the drive, the kind of load when left out.
        directory: Folder for the files.
        dbc: DBC file of the drive.
        eds: EDS file of the drive.
        yes: Take each proposal without asking; end where two are equally likely.

    Returns:
        0 when the file passes `check`, 2 when something is left to fill in.
    """
    drive = load if name is None else name
    if device is not None:
        own = dbc or eds
        if bus is not None or (dbc and eds):
            flaw = "describes the bus: leave --bus out, and one of --dbc and --eds"
            raise ConfigurationError.of("init", "--device", flaw)
        place = _place(own, directory) if own else None
        text, files = starter.of_device(load, device, drive, place)
    else:
        known = _refuse_misfits(bus, dbc, eds)
        part = _described(load, directory, dbc, eds, ask=None if yes else sys.stdin.isatty())
        text, files = starter.compose(load, known, drive, part)
    if sys.stdin.isatty() and not yes:
        text = starter.answered(text, _values(text))
    path = _write((text, files), directory, drive)
    return _name_next_steps(path)


def _name_next_steps(path: Path) -> int:
    """Print the next commands, or what is to be filled in; return the exit status."""
    print(f"wrote {path}")
    file = shlex.quote(str(path))
    try:
        load_examined(path)
    except ConfigurationError as problem:
        print(f"\nfill in, then run `adaptdrive check {file}`:\n{problem}")
        return UNUSABLE
    print(
        f"\nnext:\n  adaptdrive check {file}    # after each change\n"
        f"  adaptdrive probe {file}    # show what the drive sends; command nothing\n"
        f"  adaptdrive start {file}    # broker, daemon, panel and view; off until `enable`\n"
        f"  adaptdrive run {file}      # the daemon alone, as a service runs it"
    )
    return 0


def _refuse_misfits(
    bus: starter.BusName | None, dbc: Path | None, eds: Path | None
) -> starter.BusName:
    """Return the kind of bus; refuse a missing one, and a file that describes another."""
    if bus is None:
        devices = ", ".join(starter.device_names())
        raise ConfigurationError.of("init", "--bus", f"is missing, or --device: one of {devices}")
    if dbc is not None and bus != "can":
        raise ConfigurationError.of("--dbc", str(dbc), f"describes a drive on can, not {bus}")
    if eds is not None and bus != "canopen":
        raise ConfigurationError.of("--eds", str(eds), f"describes a drive on canopen, not {bus}")
    return bus


def _described(
    load: LoadName, directory: Path, dbc: Path | None, eds: Path | None, *, ask: bool | None
) -> str | None:
    """Return the bus part that a DBC or EDS gives, None for the reference drive."""
    if dbc is not None:
        from adaptdrive.app import described  # noqa: PLC0415 - cantools only where needed
        from adaptdrive.devices.can import kind  # noqa: PLC0415 - as above
        from adaptdrive.devices.can.database import read_dbc  # noqa: PLC0415

        database = read_dbc(dbc, dbc, "dbc")[0]
        found = list(kind.candidates(database))
        return described.can_part(database, _place(dbc, directory), _choose(load, found, ask=ask))
    if eds is not None:
        from adaptdrive.app import described  # noqa: PLC0415 - as above
        from adaptdrive.devices.canopen.mapping import candidates  # noqa: PLC0415

        found = list(candidates(eds, _NODE_ID))
        if any(one.reference == _TARGET_TORQUE for one in found):
            print(f"a drive that takes torque: see `init --device maxon-epos4 --eds {eds}` instead")
        chosen = _choose(load, found, _OF_THE_PROFILE, ask=ask)
        return described.canopen_part(_place(eds, directory), chosen)
    return None


def _place(file: Path, directory: Path) -> str:
    """Return how the configuration names a file: one in its own folder by its name alone."""
    beside = file.resolve().parent == directory.resolve()
    return file.name if beside else str(file.resolve())


def _choose(
    load: LoadName,
    known: list[description.Candidate],
    without: Collection[str] = (),
    *,
    ask: bool | None,
) -> dict[str, description.Candidate | None]:
    """Return the signal of each quantity, None for none; refuse a doubt that nobody is asked."""
    chosen: dict[str, description.Candidate | None] = {}
    for quantity, wanted in description.wanted_by(load).items():
        if quantity in without:
            continue
        proposed = description.propose(wanted, known)
        if ask is None and description.is_doubtful(wanted, proposed):
            first, second = (one.reference for one in proposed[:2])
            flaw = f"{first} or {second}? leave out --yes, and choose"
            raise ConfigurationError.of("init", quantity, flaw)
        chosen[quantity] = next(iter(proposed), None)
        if ask:
            chosen[quantity] = _asked(quantity, proposed[:_SHOWN], known)
    left_out = ", ".join(quantity for quantity, one in chosen.items() if one is None)
    if left_out and not ask:
        print(f"left out, as no signal of the file means it: {left_out}")
    return chosen


def _asked(
    quantity: str,
    proposed: tuple[description.Candidate, ...],
    known: list[description.Candidate],
) -> description.Candidate | None:
    """Return what the user chooses for a quantity, None for none."""
    choices: dict[str, description.Candidate | None] = {one.reference: one for one in known}
    choices |= {"0": None}
    print(f"\n{quantity}:")
    for number, one in enumerate(proposed, start=1):
        choices[str(number)] = one
        words = "" if one.reference.endswith(one.words.split()[-1]) else one.words
        print("  ".join(filter(None, (f"  {number}", one.reference, words, one.unit, one.range))))
    usual = "1" if proposed else "0"
    while True:
        question = f"a number, a signal by its name, or 0 for none [{usual}]: "
        answer = _answer(question, quantity) or usual
        if answer in choices:
            return choices[answer]


def _values(text: str) -> dict[str, str]:
    """Ask for each value of the example; one that is confirmed by Enter alone stays marked."""
    print("\nEnter keeps the value of the example, and `check` names it.")
    found = {}
    for key, value in starter.asked(text).items():
        while answer := _answer(f"{starter.QUESTIONS[key]} [{value}]: ", key):
            if (written := _as_toml(answer, value)) is not None:
                found[key] = written
                break
    return found


def _as_toml(answer: str, like: str) -> str | None:
    """Return an answer as TOML, None where it is not of the kind of another value."""
    if like.startswith('"'):
        return json.dumps(answer)
    try:
        number = float(answer)
    except ValueError:
        return None
    return repr(number) if math.isfinite(number) else None


def _answer(question: str, quantity: str) -> str:
    """Return what the user types; refuse an input that ends, before anything is written."""
    try:
        return input(question).strip()
    except EOFError as problem:
        print()
        flaw = "the input ended before an answer; nothing is written"
        raise ConfigurationError.of("init", quantity, flaw) from problem


def _write(first: starter.Starter, directory: Path, drive: str) -> Path:
    """Write the files of a configuration; refuse to replace any."""
    path = directory / f"{drive}.toml"
    try:
        files = {path: first[0].encode()} | {directory / n: one for n, one in first[1].items()}
        directory.mkdir(parents=True, exist_ok=True)
        for file, content in files.items():
            if os.path.lexists(file) and (file == path or file.read_bytes() != content):
                raise ConfigurationError.of(file, "init", "the file exists and is not replaced")
        for file, content in files.items():
            replace_regular(file, content)
    except (OSError, UnicodeError) as problem:
        raise ConfigurationError.of(directory, "init", str(problem)) from problem
    return path


# Commands that read a configuration and nothing else.


def check(config: Path, /, *, as_json: Json = False) -> int:
    """Validate a configuration; list every error with its place.

    The DBC or register map and the capacity of each link are checked too; no bus is opened. Values
    that can be used, but are probably not meant, give a warning on standard error; so does a
    machine on which a daemon takes more than a third of each half cycle.

    Args:
        config: Configuration file.
        as_json: Print JSON, for programs.

    Returns:
        0 when it can be used; otherwise `ConfigurationError` lists what is wrong.
    """
    if as_json:
        try:
            configuration = load_examined(config)
            report = sound_report(configuration, config)
            report["warnings"] += _shortage(configuration)
        except ConfigurationError as flawed:
            report = flawed_report(flawed)
        print_json(report)
        return 0 if report["valid"] else UNUSABLE
    from adaptdrive.devices.can.bus import missing_here  # noqa: PLC0415 - `schema` needs no bus

    text = read_text(config)
    left = [f"{key} = {value}" for key, value in starter.examples(text)]
    if left:
        remedy = "adapt each, then delete `example:` from its comment"
        _warn(config, f"values of the example: {', '.join(left)}; {remedy}")
    _advise(config, text)
    configuration = examine_text(text, config)
    if isinstance(configuration.bus, CanLink) and (problem := missing_here(configuration.bus)):
        print(f"adaptdrive: {config}: not on this machine: {problem}", file=sys.stderr)
    for one in _shortage(configuration):
        _warn(config, one)
    if configuration.signals.bridge is None and not configuration.bus.has_bridge_words:
        print(f"{config}: signals.bridge is missing: the drive cannot confirm that it has stopped")
    print(tables(configuration, config))
    unfinished = "is not configured yet: values of the example are left"
    end = unfinished if left else "is configured correctly"
    print(f"{config}: drive {configuration.drive.name} {end}")
    return 0


def _warn(config: Path, text: object) -> None:
    print(f"adaptdrive: {config}: warning: {text}", file=sys.stderr)


def _advise(config: Path, text: str) -> None:
    """Print the warnings, also where values that contradict each other are refused after them."""
    configuration, _, flaws = find_flaws(text, config)
    if not flaws:
        with suppress(ConfigurationError):  # of a DBC, EDS or register map: refused later
            for one in advice(configuration):
                _warn(config, one)


def _shortage(configuration: Configuration) -> list[str]:
    """Return the warnings of a machine that is too slow."""
    from adaptdrive.app.tick_cost import shortage  # noqa: PLC0415 - `init` needs no controller

    return [str(one) for one in shortage(configuration)]


def schema() -> int:
    """Print the JSON Schema of the configuration, for editors."""
    print(json.dumps(Configuration.model_json_schema(), indent=2, ensure_ascii=False))
    return 0
