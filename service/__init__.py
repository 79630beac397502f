"""skypose: spacecraft pose from ground-based telescope video, as a service."""
