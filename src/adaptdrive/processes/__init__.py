"""The processes that one terminal starts, watches and ends: broker, daemon, simulated drive."""
