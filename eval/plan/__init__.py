"""From the command line to runs: flags, options, experiments, execution, provenance."""
