"""Operators reach a drive here: the MQTT contract and its client."""
