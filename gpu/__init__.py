"""Silhouette scorers. This package knows no particles and no sessions."""
