"""Conditions that prevent a node from being energised, as text."""

from __future__ import annotations

from adaptdrive.hardware.canopen.emergency import Emergency, parse_emergency
from adaptdrive.hardware.canopen.master import Master
from adaptdrive.hardware.canopen.profile import DriveControl, DriveState

_UNFIT = frozenset({None, DriveState.UNKNOWN, DriveState.NOT_READY})


class Health:
    """One node's emergency, and whatever else is wrong with it."""

    def __init__(self, control: DriveControl, master: Master) -> None:
        self._control = control
        self._master = master
        self._emergency: Emergency | None = None

    @property
    def problem(self) -> str | None:
        """The most telling thing that is wrong, None when nothing is.

        `reset` does not end the emergency of a node that is not ready: the reason follows it then.
        """
        if self._emergency is not None:
            more = "" if self._master.ready else f"; not ready: {self._master.problem}"
            return f"{self._emergency}{more}"
        if self._control.fallen is not None:
            return self._control.fallen
        if not self._master.ready:
            return self._master.problem
        if self._master.overwritten:
            return "another sender has written its objects: it is set up again when that is quiet"
        state = self._control.state
        if self._control.faulty or state in _UNFIT:
            return f"the drive's state is {state or 'not known yet'}"
        return None

    def take_emergency(self, data: bytes) -> bool:
        """Take an emergency frame; False when it has not its eight bytes."""
        emergency = parse_emergency(data)
        if emergency is None:
            return False
        self._emergency = None if emergency.over else emergency
        if self._emergency is not None:
            self._control.fall(str(emergency))
        return True

    def forgive(self) -> None:
        """Forget an emergency: the node was restarted, or the operator has reset it."""
        self._emergency = None
