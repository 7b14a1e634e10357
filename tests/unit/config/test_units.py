"""Units in the spellings of makers."""

from __future__ import annotations

import pytest

from adaptdrive.config.bus import SignalSource
from adaptdrive.config.section import known_unit, unit_caution, unit_problem


@pytest.mark.parametrize(
    ("written", "unit"),
    [
        ("KW", "kW"),
        ("kw", "kW"),
        ("mv", "mV"),
        ("MV", "mV"),
        ("volt", "V"),
        ("Vdc", "V"),
        ("℃", "degC"),
        ("℃".encode("gb2312").decode("cp1252"), "degC"),
        ("deg_C", "degC"),
        ("degC", "degC"),
        ("Deg C", "degC"),
        ("celsius", "degC"),
        ("℉", "degF"),
        ("RPM", "rpm"),
        ("R/Min", "rpm"),
        ("Ω", "Ohm"),
        ("s", "s"),
        ("S", "S"),
        ("mW", "mW"),
        ("MW", "MW"),
        ("NM", "Nm"),
        ("furlong", None),
        ("Mw", None),
    ],
)
def test_a_unit_is_known_in_any_common_spelling(written: str, unit: str | None) -> None:
    assert known_unit(written) == unit


@pytest.mark.parametrize(
    ("found", "problem"),
    [
        ("0.1V", "the signal is in 0.1V: scale = 0.1 leads to V"),
        ("0.1 V", "the signal is in 0.1 V: scale = 0.1 leads to V"),
        (".01*V", "scale = 0.01"),
        ("10 mV", "the signal is in 10 mV, the quantity in V"),
        ("V", None),
        ("1 V", None),
        ("1/min", "the signal is in 1/min, the quantity in V"),
    ],
)
def test_a_unit_that_counts_in_parts_of_it_needs_a_scale(found: str, problem: str | None) -> None:
    plain = unit_problem(SignalSource(signal="a"), found, "V")
    assert (plain is None) if problem is None else (plain is not None and problem in plain)
    assert unit_problem(SignalSource(signal="a", scale=0.1), found, "V") is None


def test_an_unknown_unit_is_named_unless_its_conversion_is_stated() -> None:
    assert "the unit 'furlong' is not known" in (
        unit_caution(SignalSource(signal="a"), "furlong") or ""
    )
    assert unit_caution(SignalSource(signal="a", scale=2.0), "furlong") is None
    assert unit_caution(SignalSource(signal="a"), "0.1V") is None
    assert unit_caution(SignalSource(signal="a"), "") is None
