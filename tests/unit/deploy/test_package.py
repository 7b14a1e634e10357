"""The Debian package of `make deb`: what is in it, and that it runs where it is unpacked."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from importlib.metadata import distributions
from pathlib import Path

import pytest

from tools.pages.licences import PACKED, closure

CHECKOUT = Path(__file__).parents[3]
PACKAGE = CHECKOUT / "build" / "adaptdrive.deb"
LICENCE_FILE = re.compile("licen[cs]e|copying", re.IGNORECASE)
SOURCE = CHECKOUT / "src" / "adaptdrive"
pytestmark = [pytest.mark.proof, pytest.mark.usefixtures("outside")]

EXAMPLES = sorted(path.name for path in (CHECKOUT / "deploy" / "examples").glob("*.toml"))


def normal(name: str) -> str:
    """A distribution's name as package indices compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package's files, unpacked into a folder."""
    if shutil.which("dpkg-deb") is None:
        pytest.skip("dpkg-deb is not installed")
    if not PACKAGE.exists():
        pytest.skip("build/adaptdrive.deb is not there; `make deb` builds it")
    folder = tmp_path_factory.mktemp("package")
    subprocess.run(["dpkg-deb", "--raw-extract", PACKAGE, folder], check=True)
    if list(sources(site_packages(folder) / "adaptdrive")) != list(sources(SOURCE)):
        pytest.skip("build/adaptdrive.deb is of another state of the source; run `make deb`")
    return folder


def site_packages(tree: Path) -> Path:
    return next(tree.glob("opt/adaptdrive/lib/python3*/site-packages"))


def sources(package: Path) -> Iterator[tuple[str, bytes]]:
    """The modules below a folder, and what is in them."""
    for path in sorted(package.rglob("*.py")):
        yield str(path.relative_to(package)), path.read_bytes()


def run(tree: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the packaged command with the packaged interpreter, from where they were unpacked."""
    binaries = tree / "opt" / "adaptdrive" / "bin"
    python = binaries / "python"
    if not python.exists():
        pytest.skip(f"this machine has no {python.readlink()}")
    return subprocess.run(
        [python, "-IXfaulthandler", binaries / "adaptdrive", *words],
        env={name: text for name, text in os.environ.items() if name != "PYTHONPATH"},
        cwd=tree,
        capture_output=True,
        text=True,
        check=False,
    )


def test_every_library_is_of_the_version_that_the_tests_passed_in(tree: Path) -> None:
    lines = (CHECKOUT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if "==" in line)
    pinned = {normal(name): version for name, version in pins.items()}
    packed = {
        normal(found.name): found.version
        for found in distributions(path=[str(site_packages(tree))])
    }
    del packed["adaptdrive"]
    assert packed == {name: pinned[name] for name in packed}
    assert set(packed) == closure("adaptdrive", PACKED) - {"adaptdrive"}


def test_the_full_text_of_each_licence_is_there(tree: Path) -> None:
    notice = (tree / "usr/share/doc/adaptdrive/copyright").read_text(encoding="utf-8")
    for folder in site_packages(tree).glob("*.dist-info"):
        texts = [path for path in folder.rglob("*") if LICENCE_FILE.match(path.name)]
        name, version = folder.stem.split("-")
        assert texts or f"\n{name} {version}\n" in notice, name


def test_it_is_light(tree: Path) -> None:
    heavy = {"adaptdrive_sim", "matplotlib", "numpy", "polars", "scipy", "pip"}
    assert not heavy & {path.name for path in site_packages(tree).iterdir()}


def test_it_runs_without_anything_else(tree: Path) -> None:
    from adaptdrive import __version__  # noqa: PLC0415 - the checkout's, to compare with

    version = run(tree, "--version")
    assert version.stdout.split()[0] == __version__, version.stderr


@pytest.mark.parametrize("example", EXAMPLES)
def test_its_examples_are_valid(tree: Path, example: str) -> None:
    checked = run(tree, "check", tree / "usr" / "share" / "adaptdrive" / "examples" / example)
    assert checked.returncode == 0, checked.stderr


def test_what_an_administrator_may_change_is_kept_on_upgrades(tree: Path) -> None:
    named = (tree / "DEBIAN" / "conffiles").read_text(encoding="utf-8").split()
    shipped = [f"/{path.relative_to(tree)}" for path in (tree / "etc").rglob("*") if path.is_file()]
    assert sorted(named) == sorted(shipped)


def test_it_says_nothing_about_the_machine_that_built_it(tree: Path) -> None:
    command = ["grep", "--recursive", "--files-with-matches", "--fixed-strings"]
    command += [str(CHECKOUT), str(tree)]
    found = subprocess.run(command, check=False, capture_output=True, text=True)
    assert found.stdout == ""
    assert not list(tree.rglob("direct_url.json"))
