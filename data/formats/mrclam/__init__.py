"""UTIAS MRCLAM: files, calibration, and one robot of a dataset as a log."""
