"""What the kernel is asked for, seen from outside: its own files, and users who are refused."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("outside")
ROOT = Path(__file__).parents[3]
NOBODY = 65534

ASK = """
import os, sys
from pathlib import Path
from concurrent.futures import ThreadPoolExecutor
from adaptdrive.config.services import Realtime
from adaptdrive.runtime.realtime import helper_thread, real_time
wanted = Realtime({settings})
if {user}:
    os.setresgid({user}, {user}, {user})
    os.setresuid({user}, {user}, {user})
with real_time(wanted) as grants:
    for grant in grants:
        print(grant.asked, grant.granted, grant.meaning, sep="|")
    print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO)
    print(Path("/proc/self/status").read_text())
    with ThreadPoolExecutor(initializer=helper_thread(10)) as pool:
        print("helper", pool.submit(lambda: os.sched_getparam(0).sched_priority).result())
    print("files", *(os.readlink(one) for one in Path("/proc/self/fd").iterdir() if one.exists()))
print("files after", *(os.readlink(one) for one in Path("/proc/self/fd").iterdir() if one.exists()))
child = os.fork()
if not child:
    print("child", os.sched_getscheduler(0) == os.SCHED_OTHER, flush=True)
    os._exit(0)
os.waitpid(child, 0)
"""


def ask(settings: str, user: int = 0) -> str:
    """Ask in a process of its own, perhaps as an ordinary user."""
    code = ASK.format(settings=settings, user=user)
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "PYTHONUNBUFFERED": "1"}
    run = subprocess.run(
        [sys.executable, "-c", code],
        check=False,
        capture_output=True,
        text=True,
        timeout=60.0,
        env=environment,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def may_be_granted(settings: str) -> str:
    """The output, unless this user or machine is refused."""
    output = ask(settings)
    if "|False|" in output:
        pytest.skip(output.splitlines()[0])
    return output


def locked_kB(output: str) -> int:
    found = re.search(r"VmLck:\s+(\d+) kB", output)
    assert found is not None
    return int(found[1])


@pytest.mark.proof
def test_a_granted_priority_is_for_the_thread_and_not_for_what_it_starts() -> None:
    output = may_be_granted("priority=10")
    assert "priority = 10|True|ordinary processes cannot delay a tick" in output
    assert "\nTrue\n" in output
    assert "child True" in output
    assert "\nhelper 9\n" in output


@pytest.mark.proof
def test_locked_memory_shows_in_the_kernel_but_is_not_made_resident() -> None:
    output = may_be_granted("priority=10")
    assert locked_kB(output) > 0
    resident = re.search(r"VmRSS:\s+(\d+) kB", output)
    assert resident is not None
    assert int(resident[1]) < 80 * 1024


@pytest.mark.proof
def test_idle_cpus_are_kept_awake_for_as_long_as_the_daemon_runs() -> None:
    output = may_be_granted("cpu_latency_us=20")
    assert "cpu_latency_us = 20|True|" in output
    held, after = re.findall(r"^files(?: after)? (.*)$", output, re.MULTILINE)
    assert "/dev/cpu_dma_latency" in held.split()
    assert "/dev/cpu_dma_latency" not in after.split()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become an ordinary user")
def test_an_ordinary_user_is_refused_in_words_and_goes_on() -> None:
    output = ask("priority=10, cpu_latency_us=0", user=NOBODY)
    assert "priority = 10|False|Operation not permitted: any busy process" in output
    assert "memory in RAM|False|Operation not permitted: a tick can wait" in output
    assert "cpu_latency_us = 0|False|Permission denied: an idle CPU takes its time" in output
    assert "\nhelper 0\n" in output
    assert locked_kB(output) == 0


def test_the_daemon_imports_nothing_heavy() -> None:
    """Nor does it wake up threads of a linear algebra library."""
    code = (
        "import sys, adaptdrive.cli, adaptdrive.app.run, adaptdrive.devices.can.port\n"
        "import adaptdrive.devices.modbus\n"
        "print({'numpy', 'scipy', 'pyarrow'} & sys.modules.keys())"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    run = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, env=environment
    )
    assert run.stdout.strip() == "set()"
