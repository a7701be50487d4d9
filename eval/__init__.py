"""Replay, referee, experiments, tables, figures, report and the command line."""
