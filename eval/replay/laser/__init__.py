"""The front end of laser logs: key poses by scan matching, and loop closures found while the log is replayed."""
