"""Pose graphs with landmarks in the text format of g2o."""
