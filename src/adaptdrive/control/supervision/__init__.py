"""Supervision: which controller is in force, and what the load can reach."""
