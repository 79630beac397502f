"""The report of a pass: one HTML file that needs nothing else."""
