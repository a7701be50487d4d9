"""Scenarios: Monte Carlo runs, their store, published numbers beside ours."""
