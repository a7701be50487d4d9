"""The classic UTIAS tutorials: their treatment of a recording, what their programs do otherwise, their numbers."""
