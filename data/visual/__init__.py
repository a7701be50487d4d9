"""Logs with images: pictures are found, and their corners become observations."""
