"""What the referee asks of a laser log alone: reference relations, loop closures, the consistency of factors."""
