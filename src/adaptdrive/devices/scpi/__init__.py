"""Supplies that speak SCPI over TCP."""
