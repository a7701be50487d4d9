"""Simulated worlds: each is parameters and a function of parameters and seed."""
