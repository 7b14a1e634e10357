"""Do the tests notice faults put by hand into safety code? `python -m tools.mutation.faults`.

`faults.toml` lists them: what goes wrong, the text that is changed, and the tests that must notice.
Each is put into a copy of the sources, one after the other, and its tests run as `make test` runs
them; the checkout stays as it is. Parts of names or of files (`watchdog`, `runtime/`) choose some
of them. The result is 1 where one survives or applies no longer, or where tests fail without any.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
FAULTS = Path(__file__).with_name("faults.toml")
KILLED = "killed"
_NO_TESTS = 5
"""Status of pytest that has found no test."""

_ENDS = frozenset({0, 1, 2, _NO_TESTS})
"""Those that say something of the tests, and not of how they were called."""

_LONGEST_S = 300.0
"""Longest run of the tests of one fault: one that lets them hang is noticed, too."""

_SHOWN = 4000
"""Last characters of what tests say that are shown; the name of one that fails may come before."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes:
        name: What goes wrong.
        file: Its file, below the package.
        old: Text that is there once.
        new: Text in its place.
        tests: Files or folders of the tests that must notice it.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def applied(self, text: str) -> str | None:
        """Return the file with the fault, None where its text is not there once."""
        return text.replace(self.old, self.new) if text.count(self.old) == 1 else None

    @property
    def places(self) -> list[str]:
        """Its tests; the folder stands for a file that has another name by now."""
        found = (ROOT / "tests" / test for test in self.tests)
        existing = (path if path.exists() else path.parent for path in found)
        return [str(path.relative_to(ROOT)) for path in dict.fromkeys(existing)]


def faults() -> Iterator[Fault]:
    """Yield all faults of the list."""
    for entry in tomllib.loads(FAULTS.read_text(encoding="utf-8"))["fault"]:
        yield Fault(**{**entry, "tests": tuple(entry["tests"])})


def source(fault: Fault, root: Path = ROOT / "src") -> Path:
    """Return the file of a fault below a folder of sources."""
    return root / "adaptdrive" / fault.file


def _run(sources: Path, tests: Sequence[str], **more: str) -> tuple[bool, str]:
    """Run tests on a copy of the sources; return whether they pass, and what they say."""
    paths = os.pathsep.join([str(sources), str(ROOT / "simulators")])
    environment = {**os.environ, "PYTHONPATH": paths, "CI": "1", **more}
    words = ["-m", "not proof", "-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    paths_first = f"pythonpath={sources} {ROOT / 'simulators'} ."
    command = [sys.executable, "-m", "pytest", *words, "-o", paths_first, *tests]
    try:
        done = subprocess.run(
            command,
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=_LONGEST_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, f"no end within {_LONGEST_S:g} s"
    text = done.stdout + done.stderr
    if done.returncode not in _ENDS:
        raise RuntimeError(text[-_SHOWN:])
    return done.returncode in {0, _NO_TESTS}, text


def _failed_test(text: str) -> str:
    """Return the test that has noticed a fault, or the last line where the output names none."""
    named = [
        line for line in text.splitlines() if line.startswith(("FAILED tests/", "ERROR tests/"))
    ]
    return named[0].partition(" - ")[0] if named else text.strip().rpartition("\n")[-1]


class Trial:
    """A copy of the sources, in which one fault at a time is tried."""

    def __init__(self, sources: Path) -> None:
        """Copy the sources.

        Args:
            sources: Where to; it does not exist yet.
        """
        shutil.copytree(ROOT / "src", sources, ignore=shutil.ignore_patterns("__pycache__"))
        self._sources = sources
        self._sound: dict[str, bool] = {}

    def is_noticed(self, fault: Fault) -> bool:
        """Return whether the tests of a fault notice it, and print a line about it."""
        began_s = time.monotonic()
        verdict, how = self._judged(fault)
        took_s = time.monotonic() - began_s
        sys.stdout.write(f"{verdict}: {fault.name} [{how}] {took_s:.0f} s\n")
        sys.stdout.flush()
        return verdict == KILLED

    def _judged(self, fault: Fault) -> tuple[str, str]:
        """Return the verdict on a fault, and the test that has noticed it or where none has."""
        file = source(fault, self._sources)
        whole = file.read_text(encoding="utf-8")
        spoilt = fault.applied(whole)
        if spoilt is None:
            return "NO LONGER APPLIES", fault.file
        places = [place for place in fault.places if self._is_sound(place)]
        if not places:
            return "NOT TRIED", "its tests fail without a fault"
        file.write_text(spoilt, encoding="utf-8")
        try:
            # no other run may find a fault in the bytecode
            passed, text = _run(self._sources, places, PYTHONDONTWRITEBYTECODE="1")
        finally:
            file.write_text(whole, encoding="utf-8")
        return ("SURVIVED", ", ".join(places)) if passed else (KILLED, _failed_test(text))

    def _is_sound(self, place: str) -> bool:
        """Return whether tests pass without a fault; print the end of their output if not."""
        if place not in self._sound:
            self._sound[place], text = _run(self._sources, [place])
            if not self._sound[place]:
                sys.stdout.write(f"{place} fails without a fault:\n{text[-_SHOWN:]}\n")
        return self._sound[place]

    @property
    def is_sound(self) -> bool:
        """True if all tests that were needed pass without a fault."""
        return all(self._sound.values())


def main() -> int:
    """Try the faults whose names or files have one of the given texts, or all."""
    words = sys.argv[1:] or [""]
    chosen = [one for one in faults() if any(word in one.name + one.file for word in words)]
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        trial = Trial(Path(folder, "src"))
        noticed = [fault for fault in chosen if trial.is_noticed(fault)]
    sys.stdout.write(f"{len(noticed)} of {len(chosen)} faults were noticed\n")
    return int(not chosen or len(noticed) < len(chosen) or not trial.is_sound)


if __name__ == "__main__":
    raise SystemExit(main())
