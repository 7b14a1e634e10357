"""Devices that are asked for their values: what Modbus and SCPI have in common."""
