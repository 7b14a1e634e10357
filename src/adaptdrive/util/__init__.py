"""Timers of the kernel, delivered in the event loop."""
