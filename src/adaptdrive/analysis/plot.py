"""Figure and report of a session; the report is one HTML file that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from adaptdrive.analysis.curves import Curves, find_window, read_curves
from adaptdrive.analysis.figure import draw_session
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.replay import reconfigured
from adaptdrive.util.errors import escaped
from adaptdrive.util.files import replace_result

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font: 15px/1.45 Georgia, 'Times New Roman', serif; max-width: 60em; margin: 2em auto;
  padding: 0 1em; color: #1a1a1a; }}
h1 {{ font-size: 1.5em; }} h2 {{ font-size: 1.15em; margin-top: 1.6em; }}
img {{ width: 100%; }}
table {{ border-collapse: collapse; font-size: 0.9em; }}
th, td {{ text-align: left; padding: 0.15em 1em 0.15em 0; vertical-align: top; }}
th {{ border-bottom: 1px solid #888; }} tr.alarm {{ color: #c1121f; }}
pre {{ background: #f5f5f2; padding: 1em; overflow-x: auto; font-size: 0.85em; }}
</style></head><body>
<h1>{title}</h1>
{facts}
<img alt="output, voltages, estimates, controller in force"
  src="data:image/png;base64,{png}">
<h2>Events</h2>{events}
<h2>Operator commands</h2>{commands}
<h2>Configuration</h2><pre>{config}</pre>
</body></html>
"""
_MOST_ROWS = 1000


def report_page(session: Session, curves: Curves, png: bytes) -> str:
    """Return the report of a session as HTML.

    Args:
        session: The session.
        curves: What its figure shows.
        png: The figure.
    """
    return _PAGE.format(
        title=escape(f"{session.info.drive}, {curves.window.started:%Y-%m-%d %H:%M:%S} UTC"),
        facts=_facts(session, curves),
        png=base64.b64encode(png).decode(),
        events=_events(session, curves),
        commands=_commands(session),
        config=escape(session.config_text),
    )


def _facts(session: Session, curves: Curves) -> str:
    info, window = session.info, curves.window
    rows = [
        ("session", session.path.name),
        ("shown", f"{window.end_s - window.begin_s:.6g} s"),
        ("ended", info.ended.value),
        ("not recorded", str(info.dropped)),
        ("adaptdrive", info.version),
        *((("damaged", session.damage),) if session.damage else ()),
    ]
    return _table(("", ""), [(row, "") for row in rows])


def _events(session: Session, curves: Curves) -> str:
    window = curves.window
    rows = [
        ((f"{one.time:%H:%M:%S.%f}"[:-3], one.kind, one.detail), one.severity)
        for one in session.events
        if not one.monotonic_s < window.begin_s and not one.monotonic_s > window.end_s
    ]
    return _table(("UTC", "kind", "detail"), rows)


def _commands(session: Session) -> str:
    rows = [
        (
            (
                f"{one.time:%H:%M:%S.%f}"[:-3],
                f"{one.verb} {one.value}",
                one.user or "unknown",
                "accepted" if one.accepted else f"refused: {one.reason}",
            ),
            "",
        )
        for one in session.commands
    ]
    return _table(("UTC", "command", "sender, unverified", "answer"), rows)


def _table(heads: Sequence[str], rows: Sequence[tuple[Iterable[str], str]]) -> str:
    if not rows:
        return "<p>none</p>"
    head = "".join(f"<th>{escape(name)}</th>" for name in heads) if any(heads) else ""
    body = "".join(
        f'<tr class="{escape(kind)}">'
        + "".join(f"<td>{escape(cell)}</td>" for cell in row)
        + "</tr>"
        for row, kind in rows[:_MOST_ROWS]
    )
    left_out = f"<p>and {len(rows) - _MOST_ROWS} more</p>" if len(rows) > _MOST_ROWS else ""
    return f"<table><tr>{head}</tr>{body}</table>{left_out}"


def plot(
    path: Path, begin_s: float | None = None, end_s: float | None = None, into: Path | None = None
) -> tuple[Path, Path]:
    """Draw a session and write its report.

    Args:
        path: Directory of the session.
        begin_s: First second shown, None for the first.
        end_s: Last second shown, None for the last.
        into: Folder for the files; that of the session when None.

    Returns:
        The PNG and the HTML file.

    Raises:
        AdaptdriveError: The session cannot be read, or holds nothing there.
        OSError: The files cannot be written.
    """
    session = read_session(path)
    configuration = reconfigured(session.config_text, path / "config.toml", ())
    curves = read_curves(session, find_window(session, begin_s, end_s))
    png = draw_session(session, configuration, curves)
    folder = path if into is None else into
    figure, report = folder / "figure.png", folder / "report.html"
    page = report_page(session, curves, png)
    replace_result(figure, png)
    replace_result(report, escaped(page).encode())
    return figure, report
