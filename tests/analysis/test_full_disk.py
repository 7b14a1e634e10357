"""Files written on a disk that is full: no half file, one line that names the place."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from adaptdrive.cli import main

ROOM = 1000
"""Bytes that a file may have: less than any of the results."""


@pytest.fixture(autouse=True)
def no_bytecode(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cache no module that a command imports: Python would keep its first bytes as a whole."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)


@contextmanager
def full_disk() -> Iterator[None]:
    """Refuse all of a file that lies behind its first bytes, as a full disk does."""
    free, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (free, hard))


def refused(words: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    """Run a command that cannot write its files; return its one line."""
    with full_disk():
        status = main(words)
    errors = capfd.readouterr().err
    assert (status, errors.count("\n")) == (1, 1)
    return errors


@pytest.mark.parametrize("form", ["csv", "parquet", "mat", "mdf4", "mcap"])
def test_an_export_is_whole_or_as_before(
    session_path: Path, tmp_path: Path, form: str, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["export", str(session_path), "--to", form, "--into", str(tmp_path)]
    assert str(tmp_path) in refused(words, capfd)
    assert not list(tmp_path.iterdir())
    assert main(words) == 0
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert before
    capfd.readouterr()
    refused(words, capfd)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(("command", "result"), [("plot", "figure.png"), ("identify", "load.png")])
def test_a_figure_is_whole_or_not_there(
    session_path: Path, tmp_path: Path, command: str, result: str, capfd: pytest.CaptureFixture[str]
) -> None:
    line = refused([command, str(session_path), "--into", str(tmp_path)], capfd)
    assert str(tmp_path / result) in line
    assert not list(tmp_path.iterdir())


def test_a_first_configuration_is_whole_or_not_there(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with full_disk():
        assert main(["init", "motor", "--bus", "can", "--directory", str(tmp_path)]) == 2
    assert str(tmp_path / "motor.toml") in capfd.readouterr().err
    assert not list(tmp_path.iterdir())
