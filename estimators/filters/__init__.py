"""How to estimate: one short file per filter, generic over models (see `base`)."""
