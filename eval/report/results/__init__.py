"""Results that other programs made, scored alone: what `eval.score` prints."""
