"""CAN: any drive that a DBC file describes."""
