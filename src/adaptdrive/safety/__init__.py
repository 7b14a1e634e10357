"""Whether a drive may be driven: facts of its port, interlocks, trips and the last look."""
