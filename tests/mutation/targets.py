"""Modules whose rules keep a drive safe, and the tests that must hold each of them."""

from __future__ import annotations

_LOOP = ("tests/runtime/test_fast_loop.py", "tests/runtime/test_fast_loop_decisions.py")
_MACHINE = (
    "tests/runtime/test_machine.py",
    "tests/runtime/test_machine_manual.py",
    "tests/runtime/test_machine_properties.py",
)

TARGETS: dict[str, tuple[str, ...]] = {
    "adaptdrive.runtime.interlocks": ("tests/runtime/test_interlocks.py", *_LOOP),
    "adaptdrive.runtime.guard": ("tests/runtime/test_guard.py", *_LOOP),
    "adaptdrive.runtime.machine": (*_MACHINE, "tests/runtime/test_coasting.py"),
    "adaptdrive.operation.desk": ("tests/operation/test_desk.py",),
    "adaptdrive.runtime.fast_loop": (*_LOOP, "tests/runtime/test_deadlines.py"),
}
