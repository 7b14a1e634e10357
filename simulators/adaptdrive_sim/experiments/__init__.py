"""Experiments on the simulated plant."""
