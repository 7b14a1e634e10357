"""The history of slow steps: bounded, thinned without losing an extreme, answered page by page."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.control.signals import Command
from adaptdrive.mqtt.contract import Output, Payload, encode, load_message
from adaptdrive.mqtt.publisher import BUCKET_S, KEYS, PAGE_READINGS, PAGE_ROWS, History
from tests.unit.mqtt.memory_broker import MemoryBroker
from tests.unit.mqtt.peers import listening, load_report, publish, serving

NOW = datetime(2026, 1, 1, tzinfo=UTC)


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def step(k: int, output: float = 2.9) -> Payload:
    return load_message(load_report(k), NOW, Output()) | {"output": output}


def answer(history: History) -> list[dict[str, Any]]:
    """All rows of an answer in the order of their times."""
    pages = [json.loads(encode(page)) for page in history.pages(NOW)]
    assert [page["page"] for page in pages] == list(range(1, len(pages) + 1))
    assert {page["pages"] for page in pages} == {len(pages)}
    assert all(len(page["rows"]) <= PAGE_ROWS for page in pages)
    return [row for page in reversed(pages) for row in page["rows"]]


def recorded(outputs: list[float], period_s: float) -> History:
    clock = Clock()
    history = History(clock)
    for k, output in enumerate(outputs):
        clock.now_s = k * period_s
        history.add(step(k, output))
    return history


def test_slow_steps_of_a_bath_are_all_kept() -> None:
    rows = answer(recorded([float(k) for k in range(170)], 20.0))
    assert [row["k"] for row in rows] == list(range(170))
    assert all(set(row) == set(KEYS) for row in rows)


def test_each_bucket_of_a_fast_load_keeps_its_extremes() -> None:
    outputs = [math.sin(1.7 * k) for k in range(3600)]
    rows = answer(recorded(outputs, 1.0))
    assert len(rows) == 600
    width = round(BUCKET_S)
    buckets = [outputs[i : i + width] for i in range(0, 3600, width)]
    kept = [row["output"] for row in rows]
    for i, bucket in enumerate(buckets):
        assert sorted(kept[2 * i : 2 * i + 2]) == pytest.approx([min(bucket), max(bucket)])
    assert all(one["k"] < next_one["k"] for one, next_one in pairwise(rows))


def test_what_is_older_than_an_hour_is_forgotten_and_the_answer_bounded() -> None:
    rows = answer(recorded([math.sin(k) for k in range(20_000)], 1.0))
    assert len(rows) <= 601
    assert rows[0]["k"] >= 20_000 - 3600 - 2


def test_a_page_fits_the_brokers_limit() -> None:
    conf = Path(__file__).parents[3] / "deploy" / "mosquitto" / "adaptdrive.conf"
    words = conf.read_text(encoding="utf-8").split()
    limit = int(words[words.index("message_size_limit") + 1])
    estimates = {f"tau_product_s{i}": {"value": 1.23456789012e-7, "std": 1e-9} for i in range(5)}
    history = History(Clock())
    for k in range(2 * PAGE_ROWS):
        history.add(step(k) | {"reason": "r" * 200, "estimates": estimates})
        history._monotonic.now_s += BUCKET_S  # type: ignore[attr-defined]
    assert max(len(encode(page)) for page in history.pages(NOW)) < limit


def test_the_readings_of_five_minutes_come_back_in_their_order() -> None:
    history = History(Clock())
    history.add(step(1))
    for tenth in range(3200):
        time = NOW + timedelta(seconds=tenth / 10)
        bridge = Command(0.0, 0.0, bridge=tenth < 3000)
        measured = {"output": tenth / 7, "boost_voltage_V": math.nan, "command": bridge}
        history.add_reading({"time": time} | measured)
    pages = [json.loads(encode(page)) for page in history.pages(NOW)]
    readings = [one for page in reversed(pages) for one in page["readings"]]
    assert [one[0] for one in readings] == pytest.approx(
        [NOW.timestamp() + tenth / 10 for tenth in range(200, 3200)]
    )
    asked = [step(1)["reference"], step(1)["boost_reference_V"]]
    assert readings[0][1:] == [200 / 7, None, *asked]
    assert readings[-1][1:] == [3199 / 7, None, None, None]
    assert max(len(page["readings"]) for page in pages) <= PAGE_READINGS


async def test_a_flood_of_requests_gets_one_answer_at_a_time(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    async with (
        serving(broker, "past", tmp_path) as bench,
        listening(broker, bench.topic("#")) as ear,
    ):
        bench.hub.publish(load_report(7))
        await ear.on(bench.topic("telemetry/load"))
        for payload in ("", "{", '{"id": "x"}', "\0"):
            await publish(broker, bench.topic("ask/history"), payload)
        first = await ear.on(bench.topic("history"))
        await publish(broker, bench.topic("command/ready"), '{"id": "done"}')
        await ear.on(bench.topic("reply"))
    assert [row["k"] for row in first.content["rows"]] == [7]
    assert not first.retained
    assert sum(message.topic.endswith("/history") for message in ear.heard) <= 2 + 4
    assert bench.host.asked == []
