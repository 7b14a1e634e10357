"""Fuzz decoders for long: `python -m tools.fuzz RUNS [TARGET ...]`.

Atheris guides the inputs by what they reach, where it is installed (`pip install atheris`);
without it they are random damage. Each target runs in a process of its own, decoders of whole files
with a share of RUNS. An input that hangs is printed too: its process is ended after
`HANG_s` of processor time.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import mmap
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

LIMIT_s = 0.05
"""Processor time of one input."""

HANG_s = 10.0
RETRIES = 2
LONGEST = 1 << 14
LENGTH_BYTES = 4
SHOWN = 2000
GUIDE = "atheris"
FAILED = Path("build/fuzz")


def main() -> int:
    """Run targets one after the other, or one of them here."""
    if sys.argv[1] == "--one":
        return _one(sys.argv[2], int(sys.argv[3]), Path(sys.argv[4]))
    from tools.fuzz.targets import TARGETS  # noqa: PLC0415 - guided code is imported below

    runs, failed = int(sys.argv[1]), 0
    for name in sys.argv[2:] or TARGETS:
        failed |= _in_process(name, max(1, round(runs * TARGETS[name].share)))
    return failed


def _in_process(name: str, runs: int) -> int:
    """Run one target in a process of its own; 1 when it failed."""
    kind = "guided by coverage" if importlib.util.find_spec(GUIDE) else "random damage"
    with tempfile.NamedTemporaryFile() as last:
        last.truncate(LENGTH_BYTES + LONGEST)
        command = [sys.executable, "-m", "tools.fuzz", "--one", name, str(runs), last.name]
        began_s = time.monotonic()
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", check=False
        )
        took_s = time.monotonic() - began_s
        verdict = "passed" if done.returncode == 0 else f"FAILED with status {done.returncode}"
        sys.stdout.write(f"{name}: {runs} inputs, {kind}, {took_s:.0f} s: {verdict}\n")
        if done.returncode:
            sys.stdout.write(done.stdout[-SHOWN:] + done.stderr[-SHOWN:])
            sys.stdout.write(f"\nthe last input: {_saved(name, _kept(Path(last.name)))}\n")
        sys.stdout.flush()
    return int(done.returncode != 0)


def _kept(path: Path) -> bytes:
    content = path.read_bytes()
    length = int.from_bytes(content[:LENGTH_BYTES], "little")
    return content[LENGTH_BYTES : LENGTH_BYTES + length]


def _saved(name: str, data: bytes) -> Path:
    """Save an input for a test of its own; where."""
    path = FAILED / f"{name}.bin"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def _one(name: str, runs: int, last: Path) -> int:
    if importlib.util.find_spec(GUIDE) is None:
        return _at_random(name, runs, last)
    return _guided(name, runs, last)


def _at_random(name: str, runs: int, last: Path) -> int:
    from tools.fuzz.mutate import mutated  # noqa: PLC0415
    from tools.fuzz.targets import TARGETS  # noqa: PLC0415

    draw = random.Random(f"{name} {runs}")
    attempt = watched(name, last)
    for _ in range(runs):
        attempt(mutated(draw, TARGETS[name].corpus))
    return 0


def _guided(name: str, runs: int, last: Path) -> int:
    atheris: Any = importlib.import_module(GUIDE)  # not installed everywhere

    with atheris.instrument_imports(include=["adaptdrive"]):
        from tools.fuzz.targets import TARGETS  # noqa: PLC0415

    corpus = Path(tempfile.mkdtemp(prefix="corpus-"))
    for number, good in enumerate(TARGETS[name].corpus):
        (corpus / str(number)).write_bytes(good)
    words: list[Any] = [sys.argv[0], f"-runs={runs}", "-max_len=9000", "-verbosity=0"]
    words += [f"-artifact_prefix={corpus}-", str(corpus)]
    atheris.Setup(words, watched(name, last))
    atheris.Fuzz()
    return 0


def watched(name: str, last: Path) -> Callable[[bytes], None]:
    """Return a function that decodes one input, and leaves it in a file before it begins.

    Args:
        name: Of the target.
        last: Takes the input; a process that hangs or crashes cannot report it.
    """
    with last.open("r+b") as file:
        memory = mmap.mmap(file.fileno(), 0)

    def decode(data: bytes) -> None:
        kept = data[:LONGEST]
        memory[:LENGTH_BYTES] = len(kept).to_bytes(LENGTH_BYTES, "little")
        memory[LENGTH_BYTES : LENGTH_BYTES + len(kept)] = kept
        signal.setitimer(signal.ITIMER_PROF, HANG_s)
        attempt(name, data)

    return decode


def attempt(name: str, data: bytes) -> None:
    """Decode one input.

    Raises:
        AssertionError: It took too long, again and again.
    """
    from tools.fuzz.targets import TARGETS  # noqa: PLC0415

    target, took_s = TARGETS[name], []
    for _ in range(1 + RETRIES):  # another process may have taken the caches
        began_s = time.process_time()
        with contextlib.suppress(*target.errors):
            target.decode(data)
        took_s.append(time.process_time() - began_s)
        if took_s[-1] < LIMIT_s:
            return
    raise AssertionError(f"{name} takes {min(took_s):.3f} s for {data[:200]!r}")


if __name__ == "__main__":
    raise SystemExit(main())
