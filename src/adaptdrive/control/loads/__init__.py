"""The loads: one file each, same shape."""
