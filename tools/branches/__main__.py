"""Which lines and branches do a module's own tests run? `python -m tools.branches [PART ...]`.

A part is the beginning of the names of some modules of `tools/mutation/targets.py`: `runtime` or
`mqtt.desk`. Each module is measured with the tests that hold it there, and with no others.
What they leave out is listed, and makes the run fail.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from tools.branches.measured import Measured, read
from tools.mutation.__main__ import source_of
from tools.mutation.targets import TARGETS

HEAD = "| module | lines | not run | branches | not taken |\n|---|---|---|---|---|"


def by_tests(modules: Sequence[str]) -> dict[tuple[str, ...], list[str]]:
    """Return the modules that share their tests, by these tests."""
    found: dict[tuple[str, ...], list[str]] = {}
    for module in modules:
        found.setdefault(TARGETS[module], []).append(module)
    return found


def measure(tests: Sequence[str], files: Mapping[str, str]) -> list[Measured]:
    """Run tests in a process of their own, and return what they run of some modules.

    Args:
        tests: Files of the tests.
        files: File of each module.

    Raises:
        RuntimeError: A test fails.
    """
    with tempfile.TemporaryDirectory(prefix="branches-") as folder:
        data, report = Path(folder) / "data", Path(folder) / "report.json"
        words = ["run", "--branch", f"--data-file={data}", f"--include={','.join(files.values())}"]
        done = _coverage(*words, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests)
        if done.returncode:
            raise RuntimeError(done.stdout[-2000:])
        _coverage("json", "-q", f"--data-file={data}", "-o", str(report))
        return read(report, files)


def _coverage(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "coverage", *words]
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)


def main() -> int:
    """Measure modules and print a table; 1 when a line or a branch is left out."""
    parts = tuple(f"adaptdrive.{part}" for part in sys.argv[1:]) or ("adaptdrive",)
    chosen = [module for module in TARGETS if module.startswith(parts)]
    found: dict[str, Measured] = {}
    for tests, modules in by_tests(chosen).items():
        files = {module: str(source_of(module)) for module in modules}
        found.update({one.module: one for one in measure(tests, files)})
    rows = [found[module] for module in chosen]
    left = [f"* {line}" for row in rows for line in row.left]
    missing = ["", "Left out:", "", *left] if left else []
    sys.stdout.write("\n".join([HEAD, *(row.line for row in rows), *missing]) + "\n")
    return int(bool(left) or not rows)


if __name__ == "__main__":
    raise SystemExit(main())
