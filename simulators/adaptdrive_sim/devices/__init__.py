"""Simulated hardware as nodes on a real bus."""
