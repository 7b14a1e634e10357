"""Two experiments at once: one for a drive, and a picture of its own for each."""

from __future__ import annotations

import os
import resource
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from adaptdrive.commission.run import alone
from adaptdrive.config.regular_file import add_result
from adaptdrive.config.services import Mqtt
from adaptdrive.errors import CommissionError

PICTURE = "commission.png"


def test_a_second_experiment_on_a_drive_is_refused() -> None:
    broker = Mqtt(host="bench.example")
    with (
        alone("commissioned", broker),
        alone("another", broker),
        alone("commissioned", Mqtt(host="elsewhere.example")),
        pytest.raises(CommissionError, match=rf"commissioned by process {os.getpid()}"),
        alone("commissioned", broker),
    ):
        pytest.fail("it began")
    with alone("commissioned", broker):
        pass


def test_each_picture_has_a_file_of_its_own(tmp_path: Path) -> None:
    pictures = [f"picture {number}".encode() for number in range(20)]
    with ThreadPoolExecutor(len(pictures)) as commands:
        made = list(
            commands.map(lambda one: add_result(tmp_path / "commission.png", one), pictures)
        )
    assert [one.read_bytes() for one in made] == pictures
    numbers = ["", *range(2, len(pictures) + 1)]
    assert {one.name for one in tmp_path.iterdir()} == {f"commission{one}.png" for one in numbers}


def test_a_picture_that_cannot_be_written_leaves_no_file(tmp_path: Path) -> None:
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, usual[1]))
    try:
        with pytest.raises(OSError, match=PICTURE):
            add_result(tmp_path / PICTURE, b"picture")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert list(tmp_path.iterdir()) == []
