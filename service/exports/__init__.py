"""Attitude histories in the formats of other programs."""
