"""The runtime: the only package that reads the clock."""
