"""The live view of one drive in a terminal."""
