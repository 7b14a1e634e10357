"""Analysis of recorded sessions: figures, reports, exports. Nothing that a daemon loads."""
