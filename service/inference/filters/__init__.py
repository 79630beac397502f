"""Filters: what is believed after a frame, from what was believed before it."""
