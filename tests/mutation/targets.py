"""Modules whose rules keep a drive safe, and the tests that must hold each of them."""

from __future__ import annotations

_LOOP = ("tests/runtime/test_fast_loop.py", "tests/runtime/test_fast_loop_decisions.py")
_LOOP_MORE = (
    "tests/runtime/test_fast_loop_books.py",
    "tests/runtime/test_fast_loop_orders.py",
    "tests/runtime/test_deadlines.py",
    "tests/runtime/test_polled_drive.py",
    "tests/runtime/test_coasting.py",
)
_MACHINE = (
    "tests/runtime/test_machine.py",
    "tests/runtime/test_machine_manual.py",
    "tests/runtime/test_machine_properties.py",
)
_STOP = ("tests/runtime/test_stop_watch.py",)
_RATE = ("tests/runtime/test_half_cycles.py", "tests/runtime/test_frame_rate.py")

RUNTIME: dict[str, tuple[str, ...]] = {
    "adaptdrive.runtime.interlocks": ("tests/runtime/test_interlocks.py", *_LOOP),
    "adaptdrive.runtime.guard": ("tests/runtime/test_guard.py", *_LOOP),
    "adaptdrive.runtime.machine": (*_MACHINE, "tests/runtime/test_coasting.py"),
    "adaptdrive.runtime.fast_loop": (*_LOOP, *_LOOP_MORE, *_STOP),
    "adaptdrive.runtime.interlock_board": (*_LOOP, *_LOOP_MORE),
    "adaptdrive.runtime.half_cycles": (*_RATE, "tests/runtime/test_fast_loop.py"),
    "adaptdrive.runtime.frame_rate": _RATE,
    "adaptdrive.runtime.stop_watch": _STOP,
    "adaptdrive.runtime.stopping": _STOP,
    "adaptdrive.runtime.statistics": ("tests/runtime/test_statistics.py",),
}

OPERATION: dict[str, tuple[str, ...]] = {
    "adaptdrive.operation.desk": ("tests/operation/test_desk.py",),
}

CONTROL: dict[str, tuple[str, ...]] = {
    "adaptdrive.control.schedule": ("tests/control/test_schedule.py", *_LOOP),
}

TARGETS = RUNTIME | OPERATION | CONTROL
