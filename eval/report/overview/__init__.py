"""The first screen: one table over all logs and tasks, and two sentences above it."""
