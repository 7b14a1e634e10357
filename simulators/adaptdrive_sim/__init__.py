"""Simulated drives, loads and buses for adaptdrive."""
