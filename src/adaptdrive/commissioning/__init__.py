"""Commissioning: a bounded experiment on an unknown load, and the settings that follow from it."""
