"""Plausibility questions about a log, asked before any work is done: valid data that may not mean what it says."""
