"""Training: one loop for every system, checkpoints that are safe to open, resume to the same weights."""
