"""Drives on Modbus, TCP and RTU, as a register map describes them."""
