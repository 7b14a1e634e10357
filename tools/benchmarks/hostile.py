"""Hostile payloads for every topic that the panel reads, drawn from the schemas of the contract."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Sequence
from typing import Any

from tools.pages.asyncapi import schema
from tools.pages.topic_table import simulator_topics, topics

READ = (
    *("state", "telemetry/load", "telemetry/drive"),
    *("event", "history", "reply", "availability"),
    *("simulator/truth", "simulator/reply"),
)
"""Topics that the page reads."""

DEEP = 400
LONG = 5000
ATTACK = "window.attacked=1"
MARKUP = (
    f"<img src=x onerror={ATTACK}>",
    f"<script>{ATTACK}</script>",
    f"<svg onload={ATTACK}>",
    f"javascript:{ATTACK}",
    f'"><iframe srcdoc="<script>parent.{ATTACK}</script>">',
    f"';{ATTACK};//",
    f"${{{ATTACK}}}{{{{constructor.constructor('{ATTACK}')()}}}}",
    f"<a href='javascript:{ATTACK}'>x</a><style>*{{display:none}}</style>",
)
TEXTS = (
    *MARKUP,
    *("", " ", "NaN", "Infinity", "-Infinity", "null", "undefined", "1e999", "0x10", "-0"),
    *(
        "__proto__",
        "constructor",
        "toString",
        "hasOwnProperty",
        "\u0000\u0007\u001b[2J",
        "\u202egnp",
    ),
    *("🦾" * 300, "W" * LONG, "\u0301" * 500, "\ud800", "a\nb\r\nc\td"),
    *("1970-01-01T00:00:00Z", "+275760-09-13T00:00:00Z", "-271821-04-20T00:00:00Z"),
    *(
        "2026-11-22T00:00:00Z",
        "9999-12-31T23:59:59Z",
        "0000-01-01T00:00:00Z",
        "2026-13-45T99:99:99Z",
    ),
)
NUMBERS = (
    *(0, -0.0, 1, -1, 1e308, -1e308, 5e-324, 1e-300, 2**31, -(2**63), 2**64, 10**400, -(10**400)),
    *(0.1, 1e15, 1e21, 1e22, 1.7976931348623157e308, -1e-5, 999999.5),
)
RAW = (
    *(b"", b"\x00", b"\xff\xfe", b"\xc3\xa9", b"{", b"[]", b"null", b"true", b'"x"', b"1e999"),
    *(b"{" * 5000, b"[" * 60_000, b'{"time":NaN}', b'{"a":' * 3000 + b"1" + b"}" * 3000),
    *(b"online", b"offline", b"tripped", *(text.encode() for text in MARKUP)),
)


class Hostile:
    """Draws payloads: one in eight raw bytes, otherwise of the topic's schema with odd values."""

    def __init__(self, seed: int, names: Sequence[str] = READ) -> None:
        self._chance = random.Random(seed)
        found = {topic.name: topic for topic in (*topics(), *simulator_topics())}
        self._schemas = {name: schema(found[name]) for name in names}
        self._kinds: tuple[Callable[[], Any], ...] = (
            lambda: self._chance.choice(TEXTS),
            lambda: self._chance.choice(NUMBERS),
            lambda: self._chance.choice((None, True, False, [], {})),
            self._nested,
            self._flood,
        )

    def draw(self, topic: str) -> bytes:
        """Return a payload of a topic."""
        if topic == "availability" or self._chance.random() < 0.125:
            return self._chance.choice(RAW)
        rate = self._chance.choice((0.02, 0.1, 0.5))
        schema = self._schemas[topic]
        return json.dumps(self._value(schema, schema.get("$defs", {}), rate)).encode()

    def _value(self, schema: Any, known: dict[str, Any], rate: float) -> Any:
        """Return a value of a schema; it and each of its parts is odd at a rate."""
        if "$ref" in schema:
            schema = known[schema["$ref"].rpartition("/")[2]]
        if "anyOf" in schema:
            return self._value(self._chance.choice(schema["anyOf"]), known, rate)
        if self._chance.random() < rate and "properties" not in schema:
            return self.odd()
        return self._made(self._kind(schema), schema, known, rate)

    def _made(self, kind: str, schema: Any, known: dict[str, Any], rate: float) -> Any:
        if kind == "object":
            return self._object(schema, known, rate)
        if kind == "array":
            parts = schema.get("prefixItems") or [schema.get("items") or {}] * 3
            return [self._value(one, known, rate) for one in parts]
        plain: dict[str, Callable[[], Any]] = {
            "string": lambda: self._string(schema),
            "boolean": lambda: self._chance.random() < 0.5,
            "null": lambda: None,
        }
        return plain.get(kind, lambda: self._chance.uniform(-10.0, 400.0))()

    def _kind(self, schema: dict[str, Any]) -> str:
        kind = schema.get("type", "string" if "enum" in schema else "number")
        return str(self._chance.choice(kind) if isinstance(kind, list) else kind)

    def _object(self, schema: dict[str, Any], known: dict[str, Any], rate: float) -> dict[str, Any]:
        made = {
            name: self._value(one, known, rate)
            for name, one in schema.get("properties", {}).items()
        }
        of_any_name = schema.get("additionalProperties")
        if isinstance(of_any_name, dict):
            made |= {
                name: self._value(of_any_name, known, rate)
                for name in ("setpoint", "tau_s", self._text())
            }
        if self._chance.random() < rate:
            made[self._text()] = self.odd()
        return made

    def _string(self, schema: dict[str, Any]) -> str:
        if schema.get("format") == "date-time":
            return f"2026-11-22T{self._chance.randrange(24):02}:00:{self._chance.randrange(60):02}Z"
        return str(self._chance.choice(schema.get("enum", ("motor", "accepted"))))

    def _text(self) -> str:
        return self._chance.choice(TEXTS)

    def odd(self) -> Any:
        """Return an odd value."""
        return self._chance.choice(self._kinds)()

    def _nested(self) -> Any:
        value: Any = self._text()
        for _ in range(self._chance.randrange(1, DEEP)):
            value = [value] if self._chance.random() < 0.5 else {"value": value}
        return value

    def _flood(self) -> Any:
        count = self._chance.randrange(1, 300)
        if self._chance.random() < 0.5:
            return [self._chance.choice(NUMBERS)] * count
        return {f"{self._text()[:20]}{i}": i for i in range(count)}
