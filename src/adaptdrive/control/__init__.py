"""The controller: pure functions and values; no clock, no input or output, no logging."""
