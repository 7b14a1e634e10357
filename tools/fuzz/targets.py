"""Decoders of what comes from outside, each as a function of bytes.

Whatever the bytes are, a target ends with a value or with the error that its decoder documents.
Anything else is a fault, and so is an input that takes long.
"""

from __future__ import annotations

from tools.fuzz.descriptions import DESCRIPTIONS
from tools.fuzz.disks import DISKS
from tools.fuzz.replies import REPLIES
from tools.fuzz.target import Target
from tools.fuzz.wires import WIRES

TARGETS: dict[str, Target] = {**DESCRIPTIONS, **WIRES, **REPLIES, **DISKS}
