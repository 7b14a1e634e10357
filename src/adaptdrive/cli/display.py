"""A drive's status as text for people."""

from __future__ import annotations

from typing import Any

from adaptdrive.operation.client import DriveStatus


def describe(drive: str, status: DriveStatus) -> str:
    """A few lines that say how a drive is doing.

    Args:
        drive: Name of the drive.
        status: What it said about itself.
    """
    lines = [f"{drive} is {status.availability}"]
    if status.state is not None:
        lines += _state(status.state, live=status.availability == "online")
    if "load" in status.telemetry:
        lines += _load(status.telemetry["load"])
    if "drive" in status.telemetry:
        lines += _drive(status.telemetry["drive"])
    return "\n".join(lines)


def _state(state: dict[str, Any], *, live: bool) -> list[str]:
    rows = [
        ("state" if live else "last state", f"{state.get('state')}, since {state.get('time')}"),
        ("controller", _controller(state)),
        ("set-point", _setpoint(state)),
        ("pole", _number(state.get("pole"))),
        ("clock", str(state.get("clock"))),
    ]
    if state.get("trip"):
        rows.insert(1, ("trip", str(state["trip"])))
    return [_row(name, text) for name, text in rows]


def _load(load: dict[str, Any]) -> list[str]:
    estimates = ", ".join(
        f"{name} {_number(estimate.get('value'))} ± {_number(estimate.get('std'))}"
        for name, estimate in (load.get("estimates") or {}).items()
    )
    voltages = (
        f"asked {_number(load.get('boost_reference_V'))} V, "
        f"applied {_number(load.get('applied_V'))} V"
    )
    return [
        _row("reference", _number(load.get("reference"))),
        _row("boost", voltages),
        _row("estimates", estimates or "none"),
    ]


def _drive(drive: dict[str, Any]) -> list[str]:
    return [
        _row("output", _number(drive.get("output"))),
        _row("boost now", f"{_number(drive.get('boost_voltage_V'))} V"),
        _row("load power", f"{_number(drive.get('load_power_W'))} W"),
        _row("age", f"{_number(drive.get('age_s'))} s"),
        _row("ticks", f"{drive.get('ticks')}, missed {drive.get('missed')}"),
    ]


def _controller(state: dict[str, Any]) -> str:
    text = f"{state.get('controller')} (asked for {state.get('mode')})"
    return f"{text}: {state['reason']}" if state.get("reason") else text


def _setpoint(state: dict[str, Any]) -> str:
    wave = state.get("waveform")
    if not wave:
        return _number(state.get("setpoint"))
    return (
        f"{wave.get('shape')} {_number(wave.get('low'))} to {_number(wave.get('high'))}, "
        f"period {_number(wave.get('period_s'))} s"
    )


def _number(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, int | float) else "unknown"


def _row(name: str, text: str) -> str:
    return f"  {name:<12}{text}"
