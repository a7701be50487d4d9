"""Audit of any factor graph: leverage, deleted residuals, variance components, reliability, influence."""
