"""What the keys and columns of an open log mean, whether they come from its files or from arrays."""
