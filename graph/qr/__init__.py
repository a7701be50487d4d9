"""Smoothing problems linearized: sparse QR, marginal covariances, the score of systematic errors."""
