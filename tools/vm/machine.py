"""A small virtual machine that lives for one script: real CAN interfaces and, if asked, systemd.

It runs on the files of this machine, the checkout and its environment among them, and on a layer of
its own above them: what it writes is gone when it ends, or lies on the disk that it was given.
`prepare` makes it ready; `init` and `boot` are its first programs. It has no network but its own
loopback. Without hardware to help, Python runs in it about twenty times slower than outside.
"""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tools.vm import processors

HERE = Path(__file__).parent
_CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"), "adaptdrive", "vm")
_PROCESSOR = "max,-erms,-fsrm,-smap"
"""Emulated string instructions copy byte by byte, and `rep_good` below word by word: without them
the kernel copies with loops, ten times faster. SMAP costs time with each system call."""

PATIENCE_S = 2400.0
"""Longest life of a machine: beside the rest of the suite a boot took 500 s, and beside two busy
loops as well more than 900 s."""

_KERNEL_OPTIONS = (
    "console=ttyS0 loglevel=4 panic=-1 mitigations=off apparmor=0 audit=0 random.trust_cpu=on"
    " tsc=reliable no_timer_check clearcpuid=rep_good cgroup_no_v1=all"
    " fstab=no systemd.gpt_auto=0"
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a script ended.

    Attributes:
        status: Its exit status, None when the machine ended before it or ran out of time.
        output: What it printed.
        console: What kernel and service manager printed.
        share: Processor time that it got, of what it asked for, 0 to 1.
    """

    status: int | None
    output: str
    console: str
    share: float


def why_not() -> str | None:
    """Why there is no virtual machine here, None when there is one."""
    check = subprocess.run(
        [HERE / "prepare", "--check"], check=False, capture_output=True, text=True
    )
    return None if check.returncode == 0 else check.stdout.strip()


def make_disk(path: Path, size: str = "2G") -> None:
    """Make an empty disk: a machine that gets it finds there what it wrote before."""
    path.unlink(missing_ok=True)
    environment = os.environ | {"PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin"}
    subprocess.run(["mkfs.ext4", "-q", path, size], check=True, env=environment)


def run(
    script: str,
    folder: Path,
    *,
    timeout_s: float = PATIENCE_S,
    systemd: bool = False,
    disk: Path | None = None,
) -> Outcome:
    """Boot the machine, run a script of bash in it as root, and switch it off as by a power cut.

    Args:
        script: The script; it starts in `/`.
        folder: Shared with the machine for writing, as `/run/vm`.
        timeout_s: When to end the machine by force.
        systemd: Whether the script is a unit of systemd, started last at boot.
        disk: Keeps what the machine writes, for its next boot.
    """
    (folder / "script").write_text(script, encoding="utf-8")
    (folder / "status").unlink(missing_ok=True)
    command = _command(folder, systemd=systemd, disk=disk)
    with (folder / "qemu").open("wb") as log:
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
        ) as process:
            share = processors.wait(process, timeout_s)
        if process.returncode < 0:
            log.write(b"ended by force\n")
    status = _read(folder, "status").strip()
    console = _read(folder, "console") + _read(folder, "qemu")
    return Outcome(int(status) if status else None, _read(folder, "output"), console, share)


def _command(folder: Path, *, systemd: bool, disk: Path | None) -> list[str | Path]:
    options = f"{_KERNEL_OPTIONS} vm_boot={HERE / 'boot'}" + " vm_systemd=yes" * systemd
    drive = [] if disk is None else ["-drive", f"file={disk},format=raw,if=virtio,cache=unsafe"]
    return [
        *("qemu-system-x86_64", "-M", "q35", "-accel", "tcg,thread=multi", "-cpu", _PROCESSOR),
        *("-smp", "2", "-m", "1024", "-no-reboot"),
        *("-nodefaults", "-no-user-config", "-display", "none"),
        *("-kernel", _CACHE / "vmlinuz", "-initrd", _CACHE / "initramfs", "-append", options),
        *("-serial", f"file:{folder / 'console'}"),
        *("-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"),
        *("-virtfs", f"local,path={folder},mount_tag=run,security_model=none,multidevs=remap"),
        *drive,
    ]


def _read(folder: Path, name: str) -> str:
    file = folder / name
    return file.read_text(encoding="utf-8", errors="replace") if file.exists() else ""
