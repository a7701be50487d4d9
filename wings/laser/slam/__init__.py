"""Front end of laser logs: key poses by scan matching, and loop closures."""
