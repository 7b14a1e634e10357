"""Whatever comes from outside ends in a value or in the error that the decoder documents.

`python -m tools.fuzz 1000000` is the long form, guided by coverage.
"""

from __future__ import annotations

import contextlib
import random

import pytest

from tools.fuzz.mutate import mutated
from tools.fuzz.targets import TARGETS


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_input_ends_in_a_documented_error(name: str) -> None:
    target, draw = TARGETS[name], random.Random(name)
    for good in target.corpus:
        with contextlib.suppress(*target.errors):
            target.decode(good)
    for _ in range(target.quick):
        data = mutated(draw, target.corpus)
        try:
            target.decode(data)
        except target.errors:
            continue
        except Exception as problem:
            raise AssertionError(f"{name} of {data!r}") from problem
