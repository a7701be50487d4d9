"""Systematic errors that are estimated along: which ones, and what the battery says before and after."""
