"""The benchmark: presets over passes with known truth, offline through the worker, and what to make of the answers."""
