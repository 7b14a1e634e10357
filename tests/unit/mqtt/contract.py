"""Validators of messages: the published schemas, with no key beyond those that they name."""

from __future__ import annotations

from typing import Any

from jsonschema import Draft202012Validator

from tools.pages.asyncapi import schema
from tools.pages.topic_table import topics


def validators() -> dict[str, Draft202012Validator]:
    """A validator for each topic below `adaptdrive/<drive>/`."""
    made = {}
    for topic in topics():
        document = _strict(schema(topic))
        Draft202012Validator.check_schema(document)
        checker = Draft202012Validator.FORMAT_CHECKER
        made[topic.name] = Draft202012Validator(document, format_checker=checker)
    return made


def _strict(part: Any) -> Any:
    if isinstance(part, list):
        return [_strict(one) for one in part]
    if not isinstance(part, dict):
        return part
    strict = {name: _strict(one) for name, one in part.items()}
    return strict | ({"additionalProperties": False} if "properties" in part else {})
