"""Numerical methods that know nothing of poses."""
