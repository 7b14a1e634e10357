"""Decoders of what comes from outside, each as a function of bytes.

Whatever the bytes are, a target ends with a value or with the error that its decoder documents.
Anything else is a fault, and so is an input that takes long.
"""

from __future__ import annotations

from tests.fuzz.descriptions import DESCRIPTIONS
from tests.fuzz.disks import DISKS
from tests.fuzz.replies import REPLIES
from tests.fuzz.target import Target
from tests.fuzz.wires import WIRES

TARGETS: dict[str, Target] = {**DESCRIPTIONS, **WIRES, **REPLIES, **DISKS}
