"""Fixes and closures by source: what became of them, and their residuals."""
