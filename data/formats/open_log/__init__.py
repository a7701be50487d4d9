"""The open log folder, format 1: reader and writer."""
