"""Run a command that ends when the process which started it ends, however that happens.

    python leash.py PARENT COMMAND ARGUMENT ...

The kernel sends SIGTERM to a leashed process when its parent dies. The leash survives `exec`, so
that nothing of this file is left in the process. Needs the standard library only.
"""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def main() -> None:
    """Put this process on the leash and become the command."""
    parent, command = int(sys.argv[1]), sys.argv[2:]
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0) != 0:
        number = ctypes.get_errno()
        sys.exit(f"cannot tie {command[0]} to its parent: {os.strerror(number)}")
    if os.getppid() != parent:  # it was gone before the leash was on
        sys.exit(f"process {parent}, which started {command[0]}, is gone")
    os.execv(command[0], command)  # noqa: S606 - the point of this program


if __name__ == "__main__":
    main()
