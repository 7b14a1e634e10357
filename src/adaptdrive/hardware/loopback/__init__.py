"""A port without a bus, for tests and notebooks."""
