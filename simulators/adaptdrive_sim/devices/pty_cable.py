"""A serial cable without wires: two pseudo-terminals, each end of which is a serial port."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tty
from collections.abc import Iterator
from pathlib import Path

_CHUNK = 4096


@contextlib.contextmanager
def pty_cable(end: Path) -> Iterator[Path]:
    """Lay a cable while the block runs; the event loop carries the bytes.

    Args:
        end: Where one end is found, as a symbolic link to its pseudo-terminal.

    Yields:
        The other end.
    """
    loop = asyncio.get_running_loop()
    with _pty() as (near, near_name), _pty() as (far, far_name):
        loop.add_reader(near, _carry, near, far)
        loop.add_reader(far, _carry, far, near)
        end.symlink_to(near_name)
        try:
            yield far_name
        finally:
            end.unlink(missing_ok=True)
            loop.remove_reader(near)
            loop.remove_reader(far)


def _carry(source: int, sink: int) -> None:
    """Carry what has come; what the other end does not take in time is lost, as on a wire."""
    with contextlib.suppress(BlockingIOError):
        os.write(sink, os.read(source, _CHUNK))


@contextlib.contextmanager
def _pty() -> Iterator[tuple[int, Path]]:
    """Return a pseudo-terminal in raw mode, which stays open while it is unused."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        os.set_blocking(master, False)
        yield master, Path(os.ttyname(slave))
    finally:
        os.close(slave)
        os.close(master)
