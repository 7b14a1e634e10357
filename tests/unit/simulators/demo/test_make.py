"""What `make demo` prints before anything is installed."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from adaptdrive_sim.demo.main import next_step

pytestmark = pytest.mark.usefixtures("outside")

ROOT = Path(__file__).parents[4]
OLD = """#!/bin/sh
[ "$1" = -V ] && { echo Python 3.9.2; exit; }
exec python3 -c "import sys; sys.version_info = (3, 9, 2); exec(sys.argv[1])" "$2"
"""


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        (folder / name).write_bytes((ROOT / name).read_bytes())
    command = ["make", "demo", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_an_old_python_is_named_before_anything_is_made(tmp_path: Path) -> None:
    old = tmp_path / "old-python"
    old.write_text(OLD)
    old.chmod(0o755)
    answer = make(tmp_path, f"PYTHON={old}")
    assert answer.returncode != 0
    assert f"{old} is Python 3.9, and 3.11 or newer is needed" in answer.stderr
    assert not (tmp_path / ".venv").exists()


def test_the_environment_of_another_python_is_made_anew(tmp_path: Path) -> None:
    """pip is a fake: what counts is which Python it is run by."""
    new = tmp_path / "new-python"
    new.write_text(f"""#!/bin/sh
[ "$1" = -m ] || exec {sys.executable} "$@"
mkdir -p .venv/bin; cp "$0" .venv/bin/python; cp "$0" .venv/bin/adaptdrive-sim
""")
    new.chmod(0o755)
    left = tmp_path / ".venv" / "lib" / "left"
    left.mkdir(parents=True)
    interpreter = tmp_path / ".venv" / "bin" / "python"
    interpreter.parent.mkdir()
    interpreter.write_text(OLD)
    interpreter.chmod(0o755)
    answer = make(tmp_path, f"PYTHON={new}")
    assert not left.exists(), answer.stdout + answer.stderr


def test_the_number_of_packages_is_right(tmp_path: Path) -> None:
    planned = make(tmp_path, "--dry-run").stdout
    said = re.search(r"installing (\d+) packages, less than a minute, once", planned)
    assert said is not None
    found: set[tuple[str, str]] = set()
    _add_needed("adaptdrive", ("sim", "analysis"), found)
    assert int(said[1]) == len({name for name, _ in found})


def _add_needed(name: str, extras: tuple[str, ...], found: set[tuple[str, str]]) -> None:
    try:
        wanted = [Requirement(line) for line in requires(name) or ()]
    except PackageNotFoundError:  # of another system
        return
    for one in wanted:
        if one.marker and not any(one.marker.evaluate({"extra": extra}) for extra in extras):
            continue
        key = (one.name.lower().replace("_", "-"), ",".join(sorted(one.extras)))
        if key not in found:
            found.add(key)
            _add_needed(one.name, tuple(one.extras) or ("",), found)


def test_the_next_step_of_the_readme_works_as_typed_and_the_demonstration_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    activate = Path(sys.executable).with_name("activate")
    if not activate.exists():
        pytest.skip("this Python is in no virtual environment")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    assert next_step().startswith(f". {activate} ")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    first = re.search(r"^\. \.venv/bin/activate", readme, re.MULTILINE)
    then = re.search(r"```sh\n(adaptdrive init .*)\n", readme)
    assert first is not None
    assert then is not None
    typed = f". {activate}\n{then[1]}"
    subprocess.run(["sh", "-ec", typed], check=True, capture_output=True)
    assert (tmp_path / "pump.toml").exists()


@pytest.mark.parametrize("library", ["scipy", "polars"])
def test_the_demonstration_needs_no_library_of_the_analysis(library: str) -> None:
    """`adaptdrive[sim]` alone, as in an environment for the simulators."""
    program = f"import sys; sys.modules[{library!r}] = None; import adaptdrive_sim.demo.main"
    subprocess.run([sys.executable, "-c", program], check=True)
