"""`python -m tools.vm [--systemd] COMMAND ...`: run one command in the virtual machine."""

from __future__ import annotations

import shlex
import sys
import tempfile
from pathlib import Path

from tools.vm import machine

_TIMEOUT_S = 600.0


def main(words: list[str]) -> int:
    """Run the command; its exit status, 125 when the machine ended without one."""
    if reason := machine.why_not():
        sys.stderr.write(f"{reason}\n")
        return 125
    systemd = words[:1] == ["--systemd"]
    script = f"cd {shlex.quote(str(Path.cwd()))}\n{shlex.join(words[systemd:])}\n"
    with tempfile.TemporaryDirectory() as folder:
        outcome = machine.run(script, Path(folder), timeout_s=_TIMEOUT_S, systemd=systemd)
    sys.stdout.write(outcome.output)
    if outcome.status is None:
        sys.stderr.write(outcome.console[-4000:])
        return 125
    return outcome.status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
