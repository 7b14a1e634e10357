"""The figure and the report of a session."""

from __future__ import annotations

import base64
import re
import shutil
import struct
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet as pq

from adaptdrive.analysis.curves import find_window, read_curves
from adaptdrive.analysis.figures import draw_session, plot
from adaptdrive.analysis.replay import reconfigured
from adaptdrive.cli import main
from adaptdrive.control.signals import Mode
from adaptdrive.recording.archiver import draw
from adaptdrive.recording.reader import read_session
from adaptdrive.util.errors import RecordingError
from tests.unit.analysis.conftest import SECONDS


def test_a_curve_holds_every_extreme_of_its_time(session_path: Path) -> None:
    session = read_session(session_path)
    curves = read_curves(session, find_window(session, None, None))
    output = session.ticks["output"].to_numpy()[:-1]
    _, values = curves.ticks["output"]
    assert (values.min(), values.max()) == (output.min(), output.max())
    assert np.all(values[::2] <= values[1::2])


def test_a_part_shows_that_part_only(session_path: Path) -> None:
    session = read_session(session_path)
    window = find_window(session, 10.0, 20.0)
    curves = read_curves(session, window)
    whole = session.ticks["output"].to_numpy()[1200:2400]
    assert curves.ticks["output"][1].max() == whole.max()
    assert len(curves.slow_s) == 10
    assert (window[2] - session.info.started).total_seconds() == pytest.approx(10.0)


def test_a_part_without_ticks_is_refused(session_path: Path) -> None:
    session = read_session(session_path)
    with pytest.raises(RecordingError, match="none of them in there"):
        find_window(session, SECONDS + 10.0, None)


def test_the_archiver_draws_a_figure(
    session_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[bytes]:
        package, *words = command[command.index("-m") + 1 :]
        assert find_spec(f"{package}.__main__")
        return subprocess.CompletedProcess(command, main(words))

    monkeypatch.setattr(subprocess, "run", run)
    trip = Path(shutil.copytree(session_path, tmp_path / "trip"))
    assert draw(trip)
    assert (trip / "figure.png").read_bytes()[:4] == b"\x89PNG"


class Page(HTMLParser):
    """Collects what a browser would fetch, and what it would show."""

    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in {"src", "href"}]

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_report_needs_nothing_but_itself(session_path: Path, tmp_path: Path) -> None:
    figure, report = plot(session_path, into=tmp_path)
    png = figure.read_bytes()
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", png[16:24])
    assert width > 1000
    assert height > 800
    page = Page()
    page.feed(report.read_text(encoding="utf-8"))
    (source,) = page.sources
    assert base64.b64decode(source.removeprefix("data:image/png;base64,")) == png
    assert "stale: 54 ms" in page.text
    assert "ann@bench" in page.text
    assert re.search(r"not recorded\s*0 ticks", page.text)


def test_a_session_with_a_manual_phase_is_drawn(session_path: Path, tmp_path: Path) -> None:
    """Each source of V_c has a colour."""
    session = read_session(session_path)
    curves = read_curves(session, find_window(session, None, None))
    controllers = np.resize([mode.value for mode in Mode], len(curves.slow_s))
    slow = curves.slow | {"controller": controllers}
    configuration = reconfigured(session.config_text, tmp_path / "config.toml", ())
    assert draw_session(session, configuration, replace(curves, slow=slow))


def test_a_controller_that_does_not_exist_is_named(session_path: Path, tmp_path: Path) -> None:
    session = Path(shutil.copytree(session_path, tmp_path / "session"))
    slow = session / "slow-0001.parquet"
    table = pq.read_table(slow)
    foreign = pa.array(["tuned"] * table.num_rows)
    place = table.schema.get_field_index("controller")
    pq.write_table(table.set_column(place, "controller", foreign), slow)
    with pytest.raises(RecordingError, match=r"slow-0001.parquet: .* controller is 'tuned'"):
        plot(session, into=tmp_path)
