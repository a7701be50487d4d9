"""Foreign estimators and association methods, `NAME=FILE:ATTRIBUTE` or `NAME=MODULE:ATTRIBUTE`: located and loaded."""
