"""The recorder of a daemon, from its configuration."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from adaptdrive.app.recording import Learnt, build_recorder
from adaptdrive.recording.log_files import Recalled
from adaptdrive.runtime.reports import Hub
from adaptdrive.util.errors import RecordingError
from tests.unit.config.documents import parse


def test_a_folder_of_sessions_whose_name_is_not_utf8_is_refused_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/Pr\xfcfung"))
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    with pytest.raises(RecordingError, match=r"Pr\\udcfcfung/sessions: .* not UTF-8"):
        build_recorder(parse(), "", Hub(), Recalled(), Learnt(), lambda: None)
