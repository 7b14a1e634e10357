"""Identification of records that scipy made: files, tables, a bare step, dead times, bad input."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter, lsim

from adaptdrive.analysis.columns import columns_of_file, columns_of_table, quantity_of
from adaptdrive.analysis.load_report import as_text
from adaptdrive.analysis.record import RecordView, read_record
from adaptdrive.cli import main
from adaptdrive.lab import identify, load_session, simulate
from adaptdrive.util.errors import IdentificationError
from tests.support import sample
from tests.unit.analysis.test_simulation import ReferenceMotor, square
from tests.unit.control.systems import System
from tests.unit.devices.bench import EXAMPLES

Array = NDArray[np.float64]

ANY = RecordView()
PERIOD_s = 2.0
FINE = 50
"""Steps of scipy in a sample: a dead time of a fiftieth is exact."""


def response(
    system: System, inputs: Array, delay: float = 0.0, before: float = 0.0, period_s: float = 2.0
) -> Array:
    """The output at each sample, right before its input acts; at rest under `before` until then.

    Args:
        system: The load.
        inputs: Held from each sample to the next.
        delay: Dead time in samples.
        before: Input before the first sample.
        period_s: Time between two samples.
    """
    late = round(delay * FINE)
    held = np.concatenate((np.full(late, before), np.repeat(inputs, FINE)))[: len(inputs) * FINE]
    gain = system.numerator[-1] / system.denominator[-1]
    time_s = np.arange(len(held)) * period_s / FINE
    _, output, _ = lsim(system.state_space(), held - before, time_s, interp=False)
    return np.asarray(output[::FINE] + gain * before)


def lag(gain: float, *taus_s: float) -> System:
    denominator = np.poly([-1.0 / tau_s for tau_s in taus_s])
    return System([0.0] * len(taus_s) + [gain * denominator[-1]], denominator.tolist())


def steps(seed: int, count: int = 500, held: int = 25) -> Array:
    levels = np.random.default_rng(seed).choice([0.0, 40.0, 100.0], size=count // held)
    return np.repeat(levels, held)


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def as_csv(columns: Mapping[str, Sequence[object]]) -> str:
    rows = zip(*columns.values(), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)])


ONE, TWO = (30.0,), (40.0, 12.0)


@pytest.mark.parametrize(
    ("delay", "taus_s"),
    sample([(3.7, ONE), (0.0, TWO), *itertools.product([0.4, 1.0, 10.0], [ONE, TWO])], 2),
)
def test_lags_and_dead_time_of_a_table_are_found(delay: float, taus_s: tuple[float, ...]) -> None:
    inputs = steps(1, 300)
    output = 20.0 + response(lag(0.6, *taus_s), inputs, delay)
    output += 0.05 * np.random.default_rng(2).normal(size=len(output))
    found = identify({"u": inputs, "y": output}, sample_time_s=PERIOD_s)
    names = ["gain", "tau_s"] if len(taus_s) == 1 else ["gain", "tau_1_s", "tau_2_s"]
    assert list(found.model) == names
    for one, true in zip(found.model.values(), (0.6, *taus_s), strict=True):
        assert one.value == pytest.approx(true, abs=max(3.5 * one.std, 0.002 * true))
    late = found.load.delay_s
    assert late == pytest.approx(delay * PERIOD_s, abs=max(3.5 * found.load.delay_std_s, 0.05))
    assert found.load.disputed == ()


def slow_record(seed: int) -> tuple[Array, Array]:
    """A heater whose body warms up behind it: a lag of half a minute, and one of ten."""
    random = np.random.default_rng([seed, 33])
    inputs = np.repeat(random.choice([0.0, 50.0, 100.0], size=10), 60)
    fast, slow = lag(0.4, random.uniform(20.0, 40.0)), lag(0.3, random.uniform(300.0, 900.0))
    output = response(fast, inputs, period_s=5.0) + response(slow, inputs, period_s=5.0)
    return inputs, output + 0.2 * random.normal(size=600)


def test_slow_dynamics_beside_a_load_are_disputed() -> None:
    inputs, output = slow_record(100)
    found = identify({"u": inputs, "y": output}, sample_time_s=5.0, lags=1)
    assert "tau_s" in found.load.disputed


@pytest.mark.proof
def test_slow_dynamics_that_the_noise_model_takes_are_reported() -> None:
    reported, silent = 0, 0
    for seed in range(20):
        inputs, output = slow_record(seed + 100)
        found = identify({"u": inputs, "y": output}, sample_time_s=5.0, lags=1)
        reported += "tau_s" in found.load.disputed
        tau_s, simulated_s = (
            one["tau_s"].value for one in (found.load.parameters, found.load.simulated_parameters)
        )
        assert simulated_s > tau_s
        random = np.random.default_rng([seed, 34])
        plain = response(lag(0.6, 60.0), inputs, period_s=5.0) + 0.2 * random.normal(size=600)
        silent += not identify({"u": inputs, "y": plain}, sample_time_s=5.0, lags=1).load.disputed
    assert reported >= 19
    assert silent >= 18


def test_a_file_is_read_as_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inputs, output = (one[:300] for one in slow_record(1))
    began = datetime(2026, 3, 1, tzinfo=UTC)
    times = [(began + timedelta(seconds=5 * n)).isoformat() for n in range(300)]
    columns: dict[str, Sequence[object]] = {
        "when": times,
        "heater (%)": inputs.tolist(),
        "room": [20] * 300,
    }
    columns["temperature"] = output.tolist()
    file = written(tmp_path / "heating.csv", as_csv(columns))
    options = ["--time", "when", "--lags", "1", "--json", "--into", str(tmp_path / "made")]
    assert main(["identify", str(file), *options]) == 0
    shown = json.loads(capsys.readouterr().out)
    same = identify({"u": inputs, "y": output}, sample_time_s=5.0, lags=1)
    tau_s = same.load.parameters["tau_s"].value
    assert shown["parameters"]["tau_s"]["value"] == pytest.approx(tau_s, rel=1e-6)
    assert shown["disputed"] == list(same.load.disputed)
    assert (tmp_path / "made" / "load.png").read_bytes().startswith(b"\x89PNG")
    text = as_text(same)
    simulated_s = same.load.simulated_parameters["tau_s"].value
    assert f"{tau_s:.5g} ± " in text
    assert f"and {simulated_s:.5g} ± " in text


@pytest.mark.parametrize("kind", ["polars", "pandas", "arrow", "structured"])
def test_tables_of_every_library_are_read(kind: str) -> None:
    inputs = steps(4, 100)
    frame = pl.DataFrame(
        {"time": PERIOD_s * np.arange(100), "u": inputs, "y": response(lag(0.5, 20.0), inputs)}
    )
    table = {
        "polars": lambda: frame,
        "pandas": frame.to_pandas,
        "arrow": frame.to_arrow,
        "structured": lambda: frame.to_numpy(structured=True),
    }[kind]
    found = identify(table(), lags=1)  # type: ignore[no-untyped-call]
    assert found.model["tau_s"].value == pytest.approx(20.0, rel=1e-3)


def test_times_that_jump_divide_the_record_and_uneven_ones_do_not() -> None:
    inputs = steps(5, 300)
    time_s = PERIOD_s * np.arange(300)
    output = response(lag(0.5, 20.0), inputs)
    kept = np.r_[0:125, 150:300]
    frame = pd.DataFrame({"time": time_s[kept], "u": inputs[kept], "y": output[kept]})
    found = identify(frame, lags=1)
    assert len(found.load.residuals) == 2
    part = identify(frame, 100.0, 220.0, lags=1)
    assert sum(map(len, part.load.residuals)) == 61
    assert found.model["tau_s"].value == pytest.approx(20.0, rel=1e-3)
    few = np.delete(np.arange(300), [77, 203, 204])
    thinned = identify({"time": time_s[few], "u": inputs[few], "y": output[few]}, lags=1)
    assert len(thinned.load.residuals) == 1
    assert thinned.model["tau_s"].value == pytest.approx(20.0, rel=1e-2)


@pytest.mark.parametrize(
    ("header", "unit_s"),
    [
        *(("time_ms", 1e-3), ("t/ms", 1e-3), ("timestamp_us", 1e-6), ("epoch [ns]", 1e-9)),
        *(("time [min]", 60.0), ("Zeit [s]", 1.0), ("Time (h)", 3600.0), ("minutes", 60.0)),
        *(("time", 1.0), ("time_utc", 1.0), ("Zeit (Tage)", 86400.0), ("time [\u00b5s]", 1e-6)),
    ],
)
def test_the_unit_of_a_time_is_that_of_its_header(header: str, unit_s: float) -> None:
    began_s, wanted_s = 1.76e9, [0.0, 2.0, 4.0, 8.0]
    columns = columns_of_table({header: [(began_s + one) / unit_s for one in wanted_s]})
    times_s = columns.times_s(header)
    assert times_s - times_s[0] == pytest.approx(wanted_s, abs=1e-4)
    ((_, part),) = read_record(
        columns_of_table({header: wanted_s, "u": range(4), "y": range(4)}), ANY
    )
    assert part.period_s == pytest.approx(2.0 * unit_s)


@pytest.mark.parametrize(
    ("header", "value", "problem"),
    [
        ("time [fortnight]", 1.0, r"'fortnight' is no unit of time: write ns, us, ms, s, min"),
        ("t [-]", 1.0, "column 't .-.': '-' is no unit of time"),
        ("timestamp", 1764382421000, "1764382421000 is no time in seconds: .* 'timestamp_ms'"),
    ],
)
def test_a_time_of_no_known_unit_is_refused_by_name(
    header: str, value: float, problem: str
) -> None:
    with pytest.raises(IdentificationError, match=problem):
        columns_of_table({header: [value, value + 1]}).times_s(header)


def test_times_without_a_zone_are_subtracted_as_they_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    """In Berlin no clock shows 02:30 in the night of 29 March: a record in UTC has it."""
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    try:
        stamps = pd.date_range("2026-03-29 01:50", periods=8, freq="10min")
        for column in (stamps, stamps.to_pydatetime(), stamps.astype(str)):
            times_s = columns_of_table({"t": column}).times_s("t")
            assert np.diff(times_s).tolist() == [600.0] * 7
    finally:
        monkeypatch.undo()
        time.tzset()


PREAMBLE = "Logger 7; Büro\nStart;2026-03-01\n\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
@pytest.mark.parametrize("before", ["", PREAMBLE, "Gerät;;;\nSeriennummer;17;;\n"])
@pytest.mark.parametrize("head", ["Zeit [s];Heizung [%];Größe;y", "Zeit;u;v;y\n[s];(%);[];(°C)"])
def test_a_table_of_a_logger_is_read(tmp_path: Path, encoding: str, before: str, head: str) -> None:
    file = tmp_path / "logger.csv"
    rows = [f"{n};{n % 3},5;7;{n},25" for n in range(5)]
    file.write_bytes("\r\n".join([before + head, *rows]).encode(encoding))
    columns = columns_of_file(file)
    time_name, input_name, _, output = list(columns.values)
    assert time_name == "Zeit [s]"
    assert columns.times_s(time_name).tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert columns.numbers(input_name).tolist() == [0.5, 1.5, 2.5, 0.5, 1.5]
    assert columns.numbers(output)[-1] == 4.25


@pytest.mark.parametrize(
    ("header", "wanted", "value"),
    [
        ("speed", "rad/s", 60.0),
        ("speed (rad/s)", "rad/s", 60.0),
        ("speed [rpm]", "rad/s", 2.0 * np.pi),
        ("bath [°C]", "K", 333.15),
        ("v [mV]", "V", 0.06),
        ("voltage_mV", "V", 0.06),
        ("speed_s", "V", 60.0),
        ("frequency [Hz]", "Hz", 60.0),
        ("flow [m3/h]", "m3/h", 60.0),
        ("speed [rpm]", "V", "is in rpm, where the configuration has V"),
        ("speed [%]", "rad/s", "column 'speed .%.': is in %"),
    ],
)
def test_a_column_of_a_drive_is_in_the_unit_of_its_header_or_refused(
    header: str, wanted: str, value: float | str
) -> None:
    def found() -> float:
        return float(quantity_of(np.array([60.0]), header, wanted, "file")[0])

    if isinstance(value, float):
        assert found() == pytest.approx(value)
    else:
        with pytest.raises(IdentificationError, match=value):
            found()


def test_parts_of_too_few_samples_are_left_out_and_counted() -> None:
    """Of every length around those that the dead time and the noise model take away."""
    random, rows, count = np.random.default_rng(1), [np.arange(120)], 120
    for length in (1, 2, *range(11, 30)):
        rows.append(count + 20 + np.arange(length))
        count += 20 + length
    kept = np.concatenate([*rows, count + 20 + np.arange(100)])
    inputs = np.resize(steps(5, 300), kept[-1] + 1)
    colour = lfilter([1.0], [1.0, -0.5, 0.3, 0.2], 0.05 * random.normal(size=len(inputs)))
    output = response(lag(0.5, 20.0), inputs) + colour
    table = {"time": PERIOD_s * kept, "u": inputs[kept], "y": output[kept]}
    found = identify(table, lags=1)
    assert found.model["tau_s"].value == pytest.approx(20.0, rel=0.05)
    assert len(found.load.residuals) == len(found.ends_s) == len(found.load.used)
    assert len(found.load.residuals) + found.left_out == len(rows) + 1
    assert found.left_out > 10
    assert f"{found.left_out} parts of too few samples left out" in as_text(found)


@pytest.mark.proof
def test_a_simulation_and_the_tables_of_a_session_are_identified(session_path: Path) -> None:
    motor = ReferenceMotor(2)
    true = motor.motor.model(0.25, 1.0)
    run = simulate(EXAMPLES / "motor.toml", motor, square, 180.0)
    found = identify(run)
    assert found.model["gain"].value == pytest.approx(true["gain"], rel=0.01)
    assert found.model["tau_motor_s"].value == pytest.approx(true["tau_motor_s"], rel=0.05)
    tables, folder = identify(load_session(session_path)), identify(session_path)
    assert tables.load.parameters == folder.load.parameters
    boost = identify(
        run.ticks, time="time_s", config=EXAMPLES / "motor.toml", input="boost_voltage_V"
    )
    assert boost.model["gain"].value == pytest.approx(true["gain"], rel=0.02)
    with pytest.raises(IdentificationError, match="leave out all but the times"):
        identify(run, input="u")
    with pytest.raises(IdentificationError, match="leave out all but the times"):
        identify(session_path, input="u")


GOOD = {"time": [2 * n for n in range(60)], "u": [0, 5] * 30, "y": list(range(60))}


@pytest.mark.parametrize(
    ("change", "options", "problem"),
    [
        ({"y": [*range(17), "n/a", *range(42)]}, {}, "line 19, column 'y': 'n/a' is not a number"),
        ({"u": [*range(3), "nan", *range(56)]}, {}, "line 5, column 'u': 'nan'"),
        ({"time": [*range(30), *range(30)]}, {}, "line 32, column 'time': 0 is not after 29"),
        ({}, {"input": "boost"}, "no column 'boost'; there are: time, u, y"),
        ({}, {"time": "clock"}, "no column 'clock'"),
        ({}, {"sample_time_s": -1.0}, "-1.0 s, must be above 0"),
        ({}, {"lags": 3}, "3 lags: a load has one or two"),
        ({"u": [100] * 60}, {}, "'u' is 100 in every row: .*--before"),
        ({"p": [1] * 60, "q": [2] * 60, "u": None}, {}, "which column is the input"),
        ({"time": None}, {}, "no column of times among u, y: name it"),
        ({}, {"output": "u", "input": "u"}, "input and output are both 'u'"),
        ({}, {"lags": 1, "config": EXAMPLES / "motor.toml"}, "lags and a configuration"),
    ],
)
def test_bad_files_get_one_clear_error(
    tmp_path: Path,
    change: dict[str, list[object] | None],
    options: dict[str, Any],
    problem: str,
) -> None:
    columns = {name: values for name, values in (GOOD | change).items() if values is not None}
    file = written(tmp_path / "bad.csv", as_csv(columns))
    with pytest.raises(IdentificationError, match=problem) as refused:
        identify(file, **options)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "has no rows"),
        (b"time,u,y\n0,1,2\n1,2\n", "line 3: 2 values, where line 1 has 3"),
        (b"time,u,u\n0,1,2\n1,2,3\n", "two columns have the name 'u'"),
        (b"\xff\xfe\x00", "is no text in UTF-8 or Latin-1: it has a byte 0"),
        (b"Logger\n\nu,y\nn/a,5\n1,2\n3,4\n", "no column of times among u, y"),
        (b"time,u,y\n0,1,2\n", "1 rows are no record"),
        (b"time,u,y\n0,1,2\n1,2,2\n", "30 are needed"),
        (b"time,u,y\n", "0 rows are no record"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, content: bytes, problem: str) -> None:
    file = tmp_path / "bad.csv"
    file.write_bytes(content)
    with pytest.raises(IdentificationError, match=problem):
        identify(file)


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        (np.zeros((60, 2)), "no named columns"),
        (7, "no named columns"),
        ({"u": [1, 2, 3], "y": [1, 2]}, r"different lengths: \{'u': 3, 'y': 2\}"),
    ],
)
def test_a_table_without_names_or_of_two_lengths_is_refused(table: object, problem: str) -> None:
    with pytest.raises(IdentificationError, match=problem):
        identify(table, sample_time_s=1.0)
