"""Hardware: how a measurement arrives and a command leaves."""
