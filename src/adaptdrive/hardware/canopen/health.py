"""Conditions that prevent a node from being energised: its emergencies and its state.

Emergency (EMCY) frames in words: classes of CiA 301 by the library, single codes of CiA 402.
"""

from __future__ import annotations

from canopen.emcy import EmcyError

from adaptdrive.hardware.canopen.master import Master
from adaptdrive.hardware.canopen.profile import DriveControl, DriveState

_CODE_BYTES = 2
"""Least bytes of an emergency: some drives send the code alone, without register and detail."""

_SINGLE = {
    0x2310: "continuous over-current at the output",
    0x2320: "short circuit at the output",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "mains phase failure",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x8130: "heartbeat of the daemon lost",
    0x8140: "recovered from bus off",
}

_UNFIT = frozenset({None, DriveState.UNKNOWN, DriveState.NOT_READY})


class Emergency(EmcyError):  # noqa: N818 - never raised
    """One emergency: the library's `code`, `register` 0x1001 and `data`, which the maker adds."""

    @property
    def over(self) -> bool:
        """True if the frame reports the end of all errors."""
        return self.code >> 8 == 0

    def __str__(self) -> str:
        words = _SINGLE.get(self.code) or self.get_desc().lower() or "unknown"
        more = "" if self.register < 0 else f" (error register 0x{self.register:02X})"
        return f"emergency 0x{self.code:04X}, {words}{more}"


def parse_emergency(data: bytes) -> Emergency | None:
    """Read an emergency frame.

    Args:
        data: Its bytes.

    Returns:
        The emergency, whose register is -1 where the frame ends before it; None for a frame
        without a whole code.
    """
    if len(data) < _CODE_BYTES:
        return None
    code, register = int.from_bytes(data[:_CODE_BYTES], "little"), (*data[2:3], -1)[0]
    return Emergency(code, register, data[3:], 0.0)


def problem_of(emergency: Emergency | None, control: DriveControl, master: Master) -> str | None:
    """Return the most telling thing that is wrong with a node, None when nothing is.

    `reset` does not end the emergency of a node that is not ready: the reason follows it then.
    """
    if emergency is not None:
        more = "" if master.ready else f"; not ready: {master.problem}"
        return f"{emergency}{more}"
    if control.fallen is not None:
        return control.fallen
    if not master.ready:
        return master.problem
    if master.overwritten:
        return "another sender has written its objects: it is set up again when that is quiet"
    if control.faulty or control.state in _UNFIT:
        return f"the drive's state is {control.state or 'not known yet'}"
    return None
