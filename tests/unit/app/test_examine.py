"""Whatever a configuration or its DBC, EDS or register map holds, `check` ends with clear lines."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adaptdrive.app.examine import load_examined
from adaptdrive.cli import main
from adaptdrive.config.root import BROKER_USERS
from adaptdrive.util.errors import ConfigurationError

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
TOMLS = sorted(path.name for path in EXAMPLES.glob("*.toml"))
PATIENCE_MS = 60_000
FUZZ = settings(
    max_examples=40,
    deadline=PATIENCE_MS,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

VALUES = st.one_of(
    st.integers(-(2**70), 2**70).map(str),
    st.floats().map(lambda value: repr(value).replace("e+", "e")),
    st.sampled_from(["true", '""', '"x"', '"/dev/zero"', '"a\\u0000b"', "[]", "[1]", "{}"]),
    st.sampled_from(['"\\u001b[2J\\n"', "2026-11-21", "1e-300", "1e300", "40001", '"A.B"', "-1"]),
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for path in EXAMPLES.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path


def checked(path: Path) -> list[str]:
    """Return the lines of `adaptdrive check`, which exits with 2 for flaws and 0 for warnings."""
    complaints = io.StringIO()
    with contextlib.redirect_stderr(complaints), contextlib.redirect_stdout(io.StringIO()):
        status = main(["check", str(path)])
    lines = complaints.getvalue().splitlines()
    warning = f"adaptdrive: {path}: warning: "
    assert status == (0 if all(line.startswith(warning) for line in lines) else 2)
    for line in lines:
        assert line.startswith("adaptdrive: ")
        assert line.isprintable()
    return lines


def assigned(text: str) -> list[int]:
    """Lines that give a key a value."""
    return [at for at, line in enumerate(text.splitlines()) if re.match(r'[\w".]+ = ', line)]


@st.composite
def changed_keys(draw: st.DrawFn, name: str) -> str:
    """An example with other values, and keys that are missing or called differently."""
    lines = (EXAMPLES / name).read_text(encoding="utf-8").splitlines()
    places = assigned("\n".join(lines))
    for at in draw(st.lists(st.sampled_from(places), min_size=1, max_size=5)):
        key, _, value = lines[at].partition(" = ")
        kind = draw(st.sampled_from(["value", "key", "gone"]))
        if kind == "value":
            lines[at] = f"{key} = {draw(VALUES)}"
        elif kind == "key":
            lines[at] = f"{key}{draw(st.sampled_from(['x', '_s', '2']))} = {value}"
        else:
            lines[at] = ""
    return "\n".join(lines)


@st.composite
def spoilt(draw: st.DrawFn, text: str) -> str:
    """A text with some characters put in, taken out or replaced."""
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, len(text) - 1))
        end = min(len(text), at + draw(st.sampled_from([0, 1, 1, 2, 20, 300])))
        put = draw(st.one_of(st.text(max_size=4), st.sampled_from(["0", "-", "1e999", "nan", "|"])))
        text = text[:at] + put + text[end:]
    return text


@FUZZ
@given(data=st.data(), name=st.sampled_from(TOMLS))
def test_changed_keys_never_end_in_a_traceback(
    folder: Path, data: st.DataObject, name: str
) -> None:
    (folder / name).write_text(data.draw(changed_keys(name)), encoding="utf-8")
    checked(folder / name)


@FUZZ
@given(data=st.data(), name=st.sampled_from(TOMLS))
def test_spoilt_files_never_end_in_a_traceback(
    folder: Path, data: st.DataObject, name: str
) -> None:
    text = data.draw(spoilt((EXAMPLES / name).read_text(encoding="utf-8")))
    (folder / name).write_text(text, encoding="utf-8")
    checked(folder / name)


@FUZZ
@given(
    data=st.data(),
    pair=st.sampled_from(
        [
            ("motor.toml", "adaptdrive.dbc"),
            ("motor-inverter.toml", "inverter.dbc"),
            ("motor-cia402.toml", "cia402.eds"),
        ]
    ),
)
def test_spoilt_descriptions_never_end_in_a_traceback(
    folder: Path, data: st.DataObject, pair: tuple[str, str]
) -> None:
    configuration, description = pair
    text = data.draw(spoilt((EXAMPLES / description).read_text(encoding="cp1252")))
    (folder / description).write_bytes(text.encode("cp1252", "replace"))
    shutil.copy(EXAMPLES / configuration, folder)
    checked(folder / configuration)


def flaws(folder: Path, name: str, *changes: tuple[str, str]) -> dict[str, str]:
    """Flaws of an example in which texts are replaced, by place."""
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / name).write_text(text, encoding="utf-8")
    try:
        load_examined(folder / name)
    except ConfigurationError as error:
        return {flaw.place: flaw.message for flaw in error.flaws}
    return {}


@pytest.fixture
def pipe(folder: Path) -> Path:
    path = folder / "adaptdrive.dbc"
    path.unlink()
    os.mkfifo(path)
    return path


def test_a_pipe_as_dbc_is_not_waited_for(folder: Path, pipe: Path) -> None:
    assert str(pipe) in flaws(folder, "motor.toml")["bus.database"]


def test_the_names_of_people_are_those_of_the_broker() -> None:
    acl = (EXAMPLES.parent / "mosquitto" / "adaptdrive.acl").read_text()
    assert set(re.findall(r"^user (\w+)$", acl, re.MULTILINE)) == set(BROKER_USERS)
