"""Devices: how a measurement arrives from a drive and a command leaves for it, on each bus."""
