"""Adaptive control of a load behind a power-electronic drive."""

__version__ = "0.1.0"
