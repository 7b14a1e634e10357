"""Where everything is put together: one drive, from its configuration to its running tasks."""
