"""Logs and what produces them: SE(2), motion and sensor models, file formats, datasets and simulators."""
