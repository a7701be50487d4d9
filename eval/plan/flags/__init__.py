"""What may be asked: the table of flags, read from a command line and config files into checked options."""
