"""Linearized smoothing problems: sparse QR, marginal covariances, the score of systematic errors."""
