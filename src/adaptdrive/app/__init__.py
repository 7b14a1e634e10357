"""Assembly of the daemon of one drive, from its configuration to its running tasks."""
