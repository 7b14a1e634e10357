"""Figure and report of a session, as files."""

from __future__ import annotations

from pathlib import Path

from adaptdrive.analysis.curves import find_window, read_curves
from adaptdrive.analysis.figure import draw_session
from adaptdrive.analysis.report import report_page
from adaptdrive.errors import escaped
from adaptdrive.files import replace_result
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.what_if import reconfigured


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
