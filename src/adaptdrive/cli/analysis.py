"""Commands that make something of a record, and the guided experiment on an unknown load."""

from __future__ import annotations

import asyncio
import re
import sys
import webbrowser
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from adaptdrive.cli import UNUSABLE, options, print_error
from adaptdrive.cli.sessions import opened
from adaptdrive.util.errors import ConfigurationError
from adaptdrive.util.files import replace_result

if TYPE_CHECKING:
    from adaptdrive.commissioning.client import Guide
    from adaptdrive.commissioning.evaluation import Commissioned


# Commands that make something of a recorded session: a figure, or a file for another program.


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class SessionView:
    """Part of a session, and the form of what is made of it.

    Attributes:
        begin: First second used, from the first tick on.
        end: Last second used.
        into: Folder for the files; that of the session when left out. It is made where it is
            missing.
        show: Open the result.
        as_json: Print JSON, for programs.
    """

    begin: Annotated[options.Second, Parameter(name="--from")] = None
    end: Annotated[options.Second, Parameter(name="--to")] = None
    into: Path | None = None
    show: Annotated[options.Flag, Parameter(name="--open")] = False
    as_json: options.Json = False

    def folder(self, session: Path) -> Path:
        """Return the folder for the files; refuse one that cannot be written."""
        folder = session if self.into is None else self.into
        options.refuse_unwritable(folder)
        return folder

    def present(self, text: str, content: object, result: Path) -> int:
        """Print a text or its content as JSON, and open a file when asked for."""
        options.print_json(content) if self.as_json else print(text)
        if self.show:
            webbrowser.open(result.absolute().as_uri())
        return 0


_WHOLE = SessionView()


def plot(
    session: str | None = None,
    /,
    *,
    bode: options.Flag = False,
    view: SessionView = _WHOLE,
) -> int:
    """Draw a session: a PNG, and a report as one HTML file.

    Args:
        session: Folder of the session, or its name below the sessions of this machine; the last one
            when left out.
        bode: Draw bode.png instead: the open-loop response of the identified load with the last
            gains, its margins, and what the covariance of the load leaves open.
        view: Part of the session, and the form of the result.
    """
    if bode:
        return _plot_loop(opened(session).path, view)
    with options.needing("analysis"):
        from adaptdrive.analysis.figures import plot as plot_session  # noqa: PLC0415 - it is large
    path = opened(session).path
    figure, report = plot_session(path, view.begin, view.end, view.folder(path))
    files = {"figure": str(figure), "report": str(report)}
    return view.present(f"{figure}\n{report}", files, report)


def _plot_loop(path: Path, view: SessionView) -> int:
    with options.needing("analysis"):
        from adaptdrive.analysis import bode, model  # noqa: PLC0415 - they are large
    figure = view.folder(path) / "bode.png"
    found = model.model_of_session(path, view.begin, view.end)
    drawn = list(found.drawn())
    spread = bode.spread_of(found, drawn)
    replace_result(figure, bode.draw_loop(found, drawn, spread.margins))
    return view.present(f"{bode.as_text(found, spread)}\n\n{figure}", spread, figure)


def identify(  # noqa: PLR0913 - one parameter for each option
    source: str | None = None,
    /,
    *,
    input: str | None = None,  # noqa: A002 - the name of the option
    output: str | None = None,
    time: str | None = None,
    sample_time: float | None = None,
    before: float | None = None,
    lags: int | None = None,
    config: Path | None = None,
    view: SessionView = _WHOLE,
) -> int:
    """Identify the load from a recorded session or a CSV file, in open or closed loop.

    Prints each parameter with its standard deviation, by prediction errors and by simulation, next
    to the last on-line estimate and the configured model, the checks of the fit, and proposed
    values; draws load.png. A session takes no option for reading a CSV file.

    Args:
        source: Folder of the session, its name below the sessions of this machine, or a CSV file;
            the last session when left out.
        input: Name of the column of the input; guessed when left out, as are the next two.
        output: Name of the column of the output.
        time: Name of the column of times, in the unit of its header, else in seconds, or as dates.
        sample_time: Seconds between two rows, where there is no such column.
        before: Input before the first row, under which the load had come to rest.
        lags: Lags of the load, 1 or 2; when left out two if the record shows a second one.
        config: Configuration of the drive whose boost voltage and output the file has.
        view: Part of the record, and the form of the result.
    """
    with options.needing("analysis"):
        from adaptdrive.analysis import load_report, record  # noqa: PLC0415 - they are large
    path = Path(source) if source is not None and Path(source).is_file() else opened(source).path
    figure = view.folder(path.parent if path.is_file() else path) / "load.png"
    columns = record.RecordView(input, output, time, sample_time, before, lags, config)
    wanted = replace(columns, begin_s=view.begin, end_s=view.end)
    found = record.identify_source(path, wanted)
    replace_result(figure, load_report.draw_load(found))
    text = f"{load_report.as_text(found)}\n\n{figure}"
    return view.present(text, load_report.as_json(found), figure)


def whatif(
    session: str | None = None, /, *, settings: options.Settings = (), view: SessionView = _WHOLE
) -> int:
    """Run a session again in closed loop, against the load identified from it.

    Set-points, mode and disturbances are those of the record. Prints overshoot, settling and effort
    as recorded, as simulated with the recorded settings, and with the changed ones; draws
    whatif.png.

    Args:
        session: Folder of the session, or its name below the sessions of this machine; the last one
            when left out.
        settings: KEY=VALUE, such as load.pole=0.8; may be repeated.
        view: Part of the session, and the form of the result.
    """
    with options.needing("analysis"):
        from adaptdrive.analysis import whatif  # noqa: PLC0415 - it is large
    path = opened(session).path
    figure = view.folder(path) / "whatif.png"
    found = whatif.what_if(path, settings, view.begin, view.end)
    for one in found.idle:
        print(f"adaptdrive: {one}: has no effect on the loop", file=sys.stderr)
    replace_result(figure, whatif.draw_comparison(found, settings))
    text = f"{whatif.as_text(found)}\n\n{figure}"
    return view.present(text, whatif.as_json(found), figure)


def export(
    session: str,
    /,
    *,
    to: Literal["csv", "parquet", "mat", "mdf4", "mcap"] | None = None,
    model: options.Flag = False,
    into: Path | None = None,
    as_json: options.Json = False,
) -> int:
    """Write a session for another program: CSV, Parquet, MATLAB, MDF 4 or MCAP; or its model.

    Args:
        session: Folder of the session, or its name below the sessions of this machine.
        to: Format of the files.
        model: Write the identified load and the loop of the last gains as `tf` and `ss`, a script
            for MATLAB.
        into: Folder for the files; the present one when left out.
        as_json: Print JSON: the paths of the files.
    """
    if not (to or model):
        return print_error("adaptdrive", "export needs --to or --model", UNUSABLE)
    path, folder, files = opened(session).path, Path() if into is None else into, list[Path]()
    if model:
        files.append(_export_model(path, folder))
    if to:
        with options.needing("export"):
            from adaptdrive.analysis.export import export as export_session  # noqa: PLC0415

            files += export_session(path, to, folder)
    options.print_each(((str(one), str(one)) for one in files), as_json)
    return 0


def _export_model(path: Path, folder: Path) -> Path:
    with options.needing("analysis"):
        from adaptdrive.analysis import model  # noqa: PLC0415 - it is large
    options.refuse_unwritable(folder)
    name = re.sub(r"\W", "_", f"model_{path.name}")  # one that MATLAB accepts
    script = folder / f"{name}.m"
    replace_result(script, model.as_matlab(model.model_of_session(path)).encode())
    return script


# The guided experiment on an unknown load.

_HERE = options.Contact()
_PLACES = (Path(), Path("/etc/adaptdrive"))
_LARGEST_MOVE = 30.0


_check_move = options.refusing(
    lambda move: 0.0 < move <= _LARGEST_MOVE,
    f"A movement is above 0 and at most {_LARGEST_MOVE:g} percent.",
)
_check_patience = options.refusing(
    lambda patience: 1.0 <= patience <= 86_400.0, "A wait is 1 to 86400 seconds."
)


def commission(  # noqa: PLR0913 - the words of the command line
    drive: options.DriveName,
    /,
    *,
    config: Path | None = None,
    move: Annotated[float, Parameter(validator=_check_move)] = 5.0,
    patience: Annotated[float | None, Parameter(validator=_check_patience)] = None,
    into: Path = Path(),
    write: options.Flag = False,
    apply: options.Flag = False,
    yes: options.Flag = False,
    contact: options.Contact = _HERE,
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
    with options.needing("analysis"):
        from adaptdrive.commissioning import client, evaluation, proposal, run  # noqa: PLC0415
    if not yes and not _agreed(run.announcement(path, drive, move / 100.0, patience)):
        return 1
    options.refuse_unwritable(into)
    contact = replace(contact, config=path)
    with run.alone(drive, contact.settings):
        if write or apply:
            proposal.refuse_unwritable(path)
        guide = client.Guide(contact.settings, drive, contact.timeout)
        commissioned = asyncio.run(run.commission(path, guide, move / 100.0, patience))
        print(evaluation.as_text(commissioned))
        figure = into / "commission.png"
        replace_result(figure, evaluation.draw(commissioned))
        print(f"\n{figure}")
        if commissioned.refusal and not (write or apply):
            return 0
        digest = _write(path, commissioned) if write or apply else ""
        if apply or (not write and _agreed_to("\napply and go on in adaptive? [y/N] ")):
            digest = digest or _write(path, commissioned)
            _put_to_use(guide, commissioned, digest)
        else:
            _print_next(drive, commissioned.reached, path if write else None)
    return 0


def _write(path: Path, commissioned: Commissioned) -> str:
    """Write the settings; return the digest of the file."""
    from adaptdrive.commissioning.evaluation import write  # noqa: PLC0415 - it is large

    backup, digest = write(path, commissioned)
    print(f"\n{path} is written, the old file is {backup}")
    return digest


def _put_to_use(guide: Guide, commissioned: Commissioned, digest: str) -> None:
    from adaptdrive.commissioning.run import put_to_use  # noqa: PLC0415 - it is large

    drive, unit = guide.drive, commissioned.before.load.output_unit
    setpoint = commissioned.reached
    waited_s = asyncio.run(put_to_use(guide, digest, setpoint))
    print(
        f"{drive} holds {setpoint:.4g} {unit} in mode adaptive, in force after {waited_s:.1f} s\n\n"
        f"next:\n  adaptdrive setpoint {drive} VALUE\n  adaptdrive watch {drive}\n"
        f"  adaptdrive disable {drive}"
    )


def _print_next(drive: str, setpoint: float, written: Path | None) -> None:
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
    raise ConfigurationError.of(found[0], "file", "is not there; name one with --config")


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
