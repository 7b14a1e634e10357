"""Operators reach a drive here: the MQTT contract and the client that speaks it."""
