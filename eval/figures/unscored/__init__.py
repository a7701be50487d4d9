"""Figures of what a run says of itself, for logs without a true path."""
