"""Monte Carlo studies: scenarios, stored runs, comparison with published numbers."""
