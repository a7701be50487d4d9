"""The open log folder, format 1: reader, writer, and the checks that name file, line, column and value."""
