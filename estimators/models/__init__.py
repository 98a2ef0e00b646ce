"""What to estimate: one file per model, knowing nothing of filters (see `base`)."""
