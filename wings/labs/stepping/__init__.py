"""Step mode: a log walked frame by frame, in pictures and words."""
