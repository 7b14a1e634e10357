"""The runtime: the only place that knows time."""
