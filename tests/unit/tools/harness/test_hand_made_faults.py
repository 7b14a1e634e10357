"""The list of hand-made faults fits the sources: `python -m tools.mutation.faults` can try each."""

from __future__ import annotations

from collections import Counter

from tools.mutation.faults import ROOT, Fault, faults, source
from tools.mutation.targets import TARGETS

LEAST = {"runtime": 25, "devices": 20, "mqtt": 8, "recording": 8, "control": 10, "app": 5}


def test_each_fault_changes_one_place() -> None:
    listed = list(faults())
    assert [one.name for one in listed if not _fits(one)] == []
    assert [name for name, count in Counter(one.name for one in listed).items() if count > 1] == []
    assert [one.name for one in listed if not one.tests] == []


def test_each_fault_and_each_target_names_tests_and_a_source_that_exist() -> None:
    tests = {ROOT / "tests" / name for one in faults() for name in one.tests}
    tests |= {ROOT / name for names in TARGETS.values() for name in names}
    assert [str(path) for path in sorted(tests) if not path.exists()] == []
    modules = {name: ROOT / "src" / name.replace(".", "/") for name in TARGETS}
    places = {name: (path, path.with_suffix(".py")) for name, path in modules.items()}
    assert [name for name, two in places.items() if not any(one.exists() for one in two)] == []


def test_the_list_covers_each_part_that_keeps_a_drive_safe() -> None:
    parts = Counter(one.file.split("/")[0] for one in faults())
    assert {part for part, least in LEAST.items() if parts[part] < least} == set()


def _fits(fault: Fault) -> bool:
    """Return whether a fault changes one place of its file, into what still can be compiled."""
    spoilt = fault.applied(source(fault).read_text(encoding="utf-8"))
    if spoilt is None:
        return False
    compile(spoilt, fault.file, "exec")
    return True
