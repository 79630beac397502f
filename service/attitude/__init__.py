"""From a pose in the image to an attitude among the stars: where the camera points, and what follows from it."""
