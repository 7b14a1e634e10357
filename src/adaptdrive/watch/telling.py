"""Lines on standard error for whoever looks at a view; a terminal that is stopped takes none."""

from __future__ import annotations

import functools
import os
import sys
from concurrent.futures import Future
from contextlib import suppress

from adaptdrive.aside import in_thread

LONGEST_S = 1.0
"""Longest wait for a terminal to take what is written last."""


def tell(text: str) -> Future[None]:
    """Write a line, in a thread that may hang."""
    return in_thread(functools.partial(_write, f"{text}\n"), "adaptdrive-line")


def tell_last(text: str) -> None:
    """Write lines before the process ends, unless the terminal is gone or takes none."""
    with suppress(OSError, TimeoutError):
        tell(text).result(LONGEST_S)


def _write(text: str) -> None:
    """Write to a separate descriptor: at its end Python waits for a stream that is in use."""
    encoding, errors = sys.stderr.encoding, sys.stderr.errors
    with os.fdopen(os.dup(sys.stderr.fileno()), "w", encoding=encoding, errors=errors) as output:
        output.write(text)
