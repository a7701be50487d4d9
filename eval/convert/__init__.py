"""`slamref convert`: recordings, simulations and laser logs as open logs."""
