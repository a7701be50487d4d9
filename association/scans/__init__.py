"""Laser scans: matched to each other, searched for loop closures, drawn as a grid."""
