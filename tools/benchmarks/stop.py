"""From the publication of `disable` to the command that has the bridge off, on the bus.

A real mosquitto, the daemon as a process, and the simulated drive on the loopback bus; the operator
is a paho client that stays connected. All run with real-time priority, so that other work on the
machine is not measured. Each trial enables the drive, waits until it runs, and stops it.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from tests.support import slow_disk
from tests.system.daemon.site import BusEar, Commanded, until
from tools.benchmarks.rows import Extent, Row, quantile
from tools.benchmarks.site import prompt_site
from tools.benchmarks.tools import PRIORITY, process, try_fifo

FLOOD = Path(__file__).with_name("flood.py")
STOP = "adaptdrive/motor/command/disable"
LIMIT_MS, WORST_MS = 5.0, 20.0
EXPIRED = json.dumps({"id": "expired", "expires": "2001-01-01T00:00:00Z"})


@dataclass(frozen=True)
class Case:
    """One way to be stopped.

    Attributes:
        name: For the table.
        payload: Of the command.
        commands_per_s: Set-points that another client sends meanwhile.
        fsync_s: What each write that is waited for takes.
        retain: Whether it is published as a retained message.
    """

    name: str
    payload: bytes = b'{"id": "stop"}'
    commands_per_s: float = 0.0
    fsync_s: float = 0.0
    retain: bool = False


CASES = (
    Case("nothing else"),
    Case("empty payload", b""),
    Case("OFF, no id", b"OFF"),
    Case("expired", EXPIRED.encode()),
    Case("100 kB, no JSON", b"x" * 100_000),
    Case("retained", b"OFF", retain=True),
    Case("500 commands/s", commands_per_s=500.0),
    Case("20 set-points/s, fsync 100 ms", commands_per_s=20.0, fsync_s=0.1),
    Case("20 set-points/s, fsync 3 s", commands_per_s=20.0, fsync_s=3.0),
)


def rows(extent: Extent) -> Iterator[Row]:
    """A row for each case."""
    try_fifo(PRIORITY)
    for case in extent.pick(CASES, CASES, CASES[::5]):
        times_ms = sorted(_measure(case, extent.pick(50, 10, 1)))
        median, worst = quantile(times_ms, 0.5), times_ms[-1]
        yield Row(
            f"disable to bridge off: {case.name}",
            median,
            "ms",
            target=f"median {LIMIT_MS:g}, worst {WORST_MS:g} ms",
            met=median <= LIMIT_MS and worst <= WORST_MS,
            note=f"worst {worst:.2f} ms of {len(times_ms)} stops",
        )


def _measure(case: Case, trials: int) -> Iterator[float]:
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        site = stack.enter_context(prompt_site(folder))
        site.environment.update(slow_disk(folder, case.fsync_s) or {} if case.fsync_s else {})
        site.start_daemon()
        site.await_measurement()
        ear = stack.enter_context(BusEar(site.config))
        operator = stack.enter_context(_operator(site.broker_port))
        for _ in range(trials):
            site.run_drive()
            with _flood(site.broker_port, case.commands_per_s):
                began_s = time.monotonic()
                operator.publish(STOP, case.payload, qos=1, retain=case.retain)
                yield 1e3 * (_first_safe(ear, began_s) - began_s)
            until(lambda: site.ask("reset")["accepted"], "the drive rests")
            site.await_state(state="standby")


def _first_safe(ear: BusEar, began_s: float) -> float:
    def find() -> Commanded | None:
        return next((one for one in ear.commands() if one.safe and one.time_s > began_s), None)

    time.sleep(0.3)  # decoding what was heard must not delay the hearing
    return until(find, "the bridge is commanded off").time_s


@contextmanager
def _operator(port: int) -> Iterator[paho.Client]:
    """A client that stays connected, so that its own start is not measured."""
    client = paho.Client(CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", port)
    client.loop_start()
    try:
        until(client.is_connected, "the operator is connected")
        yield client
    finally:
        client.disconnect()
        client.loop_stop()


@contextmanager
def _flood(port: int, per_s: float) -> Iterator[None]:
    """Set-points from another client; it has been at it for some time when the block begins."""
    if not per_s:
        yield
        return
    with process([sys.executable, str(FLOOD), str(port), str(per_s)]):
        time.sleep(3.0)
        yield
