"""A terminal for processes that show a picture and take keys."""

from __future__ import annotations

import contextlib
import os
import pty


class Screen:
    """A pseudo-terminal; what was written to it."""

    def __init__(self) -> None:
        self._own, self.inner = pty.openpty()
        os.set_blocking(self._own, False)
        self._text = ""

    def read(self) -> str:
        """All that was written so far."""
        with contextlib.suppress(BlockingIOError, OSError):
            while chunk := os.read(self._own, 65536):
                self._text += chunk.decode(errors="replace")
        return self._text

    def press(self, key: str) -> None:
        os.write(self._own, key.encode())

    def close(self) -> None:
        os.close(self._own)
        os.close(self.inner)
