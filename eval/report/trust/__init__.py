"""What a log says about itself, in words, tables and a figure."""
