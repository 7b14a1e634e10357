"""Mutants that no test can notice, each with the reason."""

from __future__ import annotations

REASONS: dict[str, str] = {}
