"""The command line without a process of its own, which takes a third of a second to start."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import tempfile
from pathlib import Path
from unittest.mock import patch

from adaptdrive.cli import main


def run_here(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command as the program does, in a wide terminal.

    Args:
        words: Words after the program's name.
        environment: What it finds in its environment.
    """
    errors = io.StringIO()
    with (
        tempfile.NamedTemporaryFile("w", encoding="utf-8") as output,
        patch.dict(os.environ, {"COLUMNS": "200", **environment}),
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(errors),
    ):
        status = main(words)
        output.flush()
        told = Path(output.name).read_text(encoding="utf-8")
    return subprocess.CompletedProcess(words, status, told, errors.getvalue())
