"""Review: everything that is made of a flight afterwards, from its log alone."""
