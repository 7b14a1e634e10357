"""The contract as one AsyncAPI 3 document, and as a JSON Schema for each topic.

`python -m tools.pages.asyncapi FOLDER` writes them.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import msgspec

from adaptdrive import __version__
from adaptdrive.mqtt.commands import FORMS
from tools.pages.topic_table import Availability, Topic, attributes, simulator_topics, topics

Document = dict[str, Any]

_DESCRIPTION = (
    "One daemon controls one drive. It publishes state, telemetry and events, and answers "
    "commands. Payloads are JSON in SI units with RFC 3339 times in UTC. A number that is unknown "
    "or not finite is null. Later versions may add keys."
)
_REPLY = "reply"
_NONE = re.compile(r"\bNone\b")


def asyncapi() -> Document:
    """Return the AsyncAPI 3 document of the daemon."""
    found = (*topics(), *simulator_topics())
    messages: Document = {}
    schemas: Document = {}
    for sent in (True, False):
        part = [topic for topic in found if topic.sent is sent]
        bodies, types = msgspec.json.schema_components(
            [topic.payload for topic in part], ref_template="#/components/schemas/{name}"
        )
        messages |= {_id(one): _message(one, body) for one, body in zip(part, bodies, strict=True)}
        schemas |= _polished(types, nullable=sent)
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "adaptdrive",
            "version": __version__,
            "description": _DESCRIPTION,
            "license": {"name": "MIT"},
        },
        "defaultContentType": "application/json",
        "servers": {"broker": {"host": "127.0.0.1:1883", "protocol": "mqtt"}},
        "channels": {_id(topic): _channel(topic) for topic in found},
        "operations": {_id(topic): _operation(topic) for topic in found},
        "components": {"messages": messages, "schemas": schemas},
    }


def schema(topic: Topic) -> Document:
    """Return the JSON Schema of the payloads of a topic."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": topic.address,
        **_polished(msgspec.json.schema(topic.payload), nullable=topic.sent),
    }


def _id(topic: Topic) -> str:
    return topic.name.replace("/", "_")


def _channel(topic: Topic) -> Document:
    return {
        "address": topic.address,
        "description": topic.summary,
        "parameters": {"drive": {"description": "name of the drive"}},
        "messages": {_id(topic): {"$ref": f"#/components/messages/{_id(topic)}"}},
    }


def _operation(topic: Topic) -> Document:
    operation: Document = {
        "action": "send" if topic.sent else "receive",
        "channel": {"$ref": f"#/channels/{_id(topic)}"},
        "summary": topic.summary,
        "bindings": {
            "mqtt": {"qos": topic.qos, "retain": topic.retained, "bindingVersion": "0.2.0"}
        },
    }
    if topic.name.rpartition("/")[2] in FORMS:
        operation["reply"] = {"channel": {"$ref": f"#/channels/{_REPLY}"}}
    return operation


def _message(topic: Topic, body: Document) -> Document:
    message: Document = {"name": _id(topic), "payload": body}
    if topic.payload is Availability:
        message["contentType"] = "text/plain"
    return message


def _polished(schema: Any, *, nullable: bool) -> Any:
    """Let each number be null, and move the meanings from a docstring to the properties."""
    if isinstance(schema, list):
        return [_polished(one, nullable=nullable) for one in schema]
    if not isinstance(schema, dict):
        return schema
    polished = {name: _polished(one, nullable=nullable) for name, one in schema.items()}
    if nullable and polished.get("type") == "number":
        polished["type"] = ["number", "null"]
    if isinstance(text := polished.get("description"), str):
        polished["description"] = _NONE.sub("null", text.partition("\n")[0])
        for name, meaning in attributes(text).items():
            described = polished.get("properties", {}).get(name, {})
            described.setdefault("description", _NONE.sub("null", meaning))
    return polished


def write(folder: Path) -> None:
    """Write the document and the schemas.

    Args:
        folder: Folder for `asyncapi.json` and `TOPIC.schema.json`.
    """
    for name, document in documents().items():
        (folder / name).write_text(document, encoding="utf-8")


def documents() -> dict[str, str]:
    """Return the text of each file by its name."""
    found = {"asyncapi.json": asyncapi()}
    found |= {
        f"{_id(topic)}.schema.json": schema(topic) for topic in (*topics(), *simulator_topics())
    }
    return {
        name: json.dumps(document, indent=1, ensure_ascii=False) + "\n"
        for name, document in found.items()
    }


if __name__ == "__main__":
    write(Path(sys.argv[1]))
