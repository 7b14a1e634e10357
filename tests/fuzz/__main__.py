"""Fuzz decoders for long: `python -m tests.fuzz RUNS [TARGET ...]`.

Atheris guides the inputs by what they reach, where it is installed (`pip install atheris`);
without it they are random damage. Each target runs in a process of its own.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

LIMIT_s = 0.05
"""Processor time of one input."""

RETRIES = 2


def main() -> int:
    """Run targets one after the other, or one of them here."""
    if sys.argv[1] == "--one":
        return _one(sys.argv[2], int(sys.argv[3]))
    from tests.fuzz.targets import TARGETS  # noqa: PLC0415 - guided code is imported below

    runs, failed = sys.argv[1], 0
    for name in sys.argv[2:] or TARGETS:
        command = [sys.executable, "-m", "tests.fuzz", "--one", name, runs]
        began_s = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        tail = (done.stdout + done.stderr).strip().splitlines()[-1:]
        verdict = "passed" if done.returncode == 0 else "FAILED"
        took_s = time.monotonic() - began_s
        sys.stdout.write(f"{name}: {runs} inputs, {took_s:.0f} s: {verdict}; {tail}\n")
        sys.stdout.flush()
        if done.returncode:
            failed = 1
            sys.stdout.write((done.stdout + done.stderr)[-3000:])
    return failed


def _one(name: str, runs: int) -> int:
    if importlib.util.find_spec("atheris") is None:
        return _at_random(name, runs)
    return _guided(name, runs)


def _at_random(name: str, runs: int) -> int:
    from tests.fuzz.mutate import mutated  # noqa: PLC0415
    from tests.fuzz.targets import TARGETS  # noqa: PLC0415

    draw = random.Random(f"{name} {runs}")
    for _ in range(runs):
        attempt(name, mutated(draw, TARGETS[name].corpus))
    sys.stdout.write("random inputs\n")
    return 0


def _guided(name: str, runs: int) -> int:
    atheris: Any = importlib.import_module("atheris")  # not installed everywhere

    with atheris.instrument_imports(include=["adaptdrive"]):
        from tests.fuzz.targets import TARGETS  # noqa: PLC0415

    corpus = Path(tempfile.mkdtemp(prefix="corpus-"))
    for number, good in enumerate(TARGETS[name].corpus):
        (corpus / str(number)).write_bytes(good)
    words: list[Any] = [sys.argv[0], f"-runs={runs}", "-max_len=9000", "-verbosity=0", str(corpus)]
    atheris.Setup(words, lambda data: attempt(name, data))
    atheris.Fuzz()
    return 0


def attempt(name: str, data: bytes) -> None:
    """Decode one input.

    Raises:
        AssertionError: It took too long, again and again.
    """
    from tests.fuzz.targets import TARGETS  # noqa: PLC0415

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
