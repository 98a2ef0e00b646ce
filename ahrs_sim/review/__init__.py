"""Review: everything that is said about a flight afterwards, from its log alone."""
