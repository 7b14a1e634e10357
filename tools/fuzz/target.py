"""What a decoder is to the fuzzers, and the files that some of them read."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
MEMORY = Path("/dev/shm")
"""Files are damaged a million times: in memory, where there is such a folder."""


@dataclass(frozen=True, slots=True)
class Target:
    """A decoder.

    Attributes:
        decode: Takes any bytes.
        errors: What it may raise.
        corpus: Good inputs, from which mutations begin.
        quick: Inputs for a test of a few seconds.
        share: Part of the inputs of the long form; a decoder of whole files has a tenth.
    """

    decode: Callable[[bytes], object]
    errors: tuple[type[Exception], ...]
    corpus: tuple[bytes, ...]
    quick: int
    share: float = 1.0


def damaged_file(name: str, data: bytes) -> Path:
    """Return the path of a file with these bytes.

    Args:
        name: Its name; the file before it of the same name is overwritten.
        data: Its content.
    """
    path = scratch() / name
    path.write_bytes(data)
    return path


@functools.cache
def scratch() -> Path:
    """Return a folder that is kept until the process ends."""
    place = MEMORY if MEMORY.is_dir() else None
    folder = tempfile.TemporaryDirectory(prefix="fuzz-", dir=place)
    _KEPT.append(folder)
    return Path(folder.name)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []
