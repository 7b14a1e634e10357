"""One line for the service manager: where the drive is, and what is awaited."""

from __future__ import annotations

from adaptdrive.runtime.reports import State, StateReport


def status_line(
    report: StateReport, bus_problem: str | None, cause: str | None, *, recorded: bool = True
) -> str:
    """Return the state of a drive and what it waits for, and whether recording has failed.

    Args:
        report: The state.
        bus_problem: Why the bus is lost, None while it is there.
        cause: Interlock that is active now, None for none. Only what comes before its colon is
            returned: the figures behind it change all the time.
        recorded: Whether all that is to be recorded is.
    """
    line = _state_line(report, bus_problem, cause)
    return line if recorded else f"{line}; recording has failed"


def _state_line(report: StateReport, bus_problem: str | None, cause: str | None) -> str:
    obstacle = bus_problem or (cause and cause.partition(":")[0])
    match report.state:
        case State.STANDBY:
            awaited = f"the drive ({obstacle})" if obstacle else "enable"
            return f"standby, waiting for {awaited}"
        case State.STARTING:
            return "starting, waiting for the boost voltage"
        case State.TRIPPED:
            awaited = f"its cause to go ({obstacle})" if obstacle else "reset"
            return f"tripped, waiting for {awaited}: {report.trip}"
        case State.STOPPING:
            return "stopping, waiting for the drive to confirm that its bridge is off"
        case State.RUNNING if report.coasting:
            return f"running, {report.reason}"
        case State.RUNNING:
            why = f": {report.reason}" if report.reason else ""
            return f"running, {report.controller} controller{why}"
