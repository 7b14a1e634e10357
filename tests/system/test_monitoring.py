"""Debian's exporter for Prometheus with the shipped configuration, beside a real broker."""

from __future__ import annotations

import asyncio
import re
import shutil
import socket
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from tests.support import Broker, start_process, stop_process
from tests.unit.deploy.test_monitoring import EXPORTER, trip_numbers
from tests.unit.mqtt.peers import OVER_VOLTAGE, PATIENCE_S, drive_report, load_report, serving


def scraped(port: int) -> str:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=1.0) as answer:
            return str(answer.read().decode())
    except (urllib.error.URLError, TimeoutError, ConnectionError):
        return ""


@pytest.mark.proof
async def test_debians_exporter_shows_a_drive_to_prometheus(
    mosquitto: Broker, tmp_path: Path
) -> None:
    program = shutil.which("prometheus-mqtt-exporter")
    if program is None:
        pytest.skip("prometheus-mqtt-exporter is not installed")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    text, config = EXPORTER.read_text(encoding="utf-8"), tmp_path / "exporter.yaml"
    config.write_text(text.replace(":1883", f":{mosquitto.port}"), encoding="utf-8")
    words = ("-config", str(config), "-listen-address", "127.0.0.1")
    process = start_process([program, *words, "-listen-port", str(port)], tmp_path / "exporter.log")
    try:
        async with serving(mosquitto, "scraped", tmp_path) as bench, asyncio.timeout(PATIENCE_S):
            page = ""
            bench.host.trip(OVER_VOLTAGE)
            while not re.search(r"^adaptdrive_missed_total\{.*\} 1\b", page, re.MULTILINE):
                bench.hub.publish(load_report(7))
                bench.hub.publish(drive_report(840))
                await asyncio.sleep(0.1)
                page = await asyncio.to_thread(scraped, port)
    finally:
        stop_process(process)
    pattern = r'^(adaptdrive_\w+)\{.*sensor="scraped".*\} (\S+)'
    values = dict(re.findall(pattern, page, re.MULTILINE))
    assert float(values["adaptdrive_boost_volts"]) == 300.5
    assert float(values["adaptdrive_lateness_p99_microseconds"]) == 20.0
    assert float(values["adaptdrive_boost_reference_volts"]) == 302.0
    assert float(values["adaptdrive_trip_kind"]) == trip_numbers()["over-voltage"]
