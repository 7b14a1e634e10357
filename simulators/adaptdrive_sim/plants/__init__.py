"""Physics: boost stage, dc/dc stage and loads."""
