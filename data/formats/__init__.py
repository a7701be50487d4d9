"""Every format in a file or folder of its own: read strictly, with file, line and value of whatever is wrong."""
