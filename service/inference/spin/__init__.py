"""The rotation of a body over a whole pass, from what each frame says by itself (docs/motion.md)."""
