"""Logs with images: pictures are detected, and their corners become observations."""
