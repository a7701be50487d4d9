"""Simulated worlds: each is parameters and a function of them and a seed."""
