"""Logs and their sources: SE(2), motion and sensor models, file formats, datasets and simulators."""
