"""The filter: NumPy and SciPy only, pure functions, no I/O, clock, global or thread."""
