"""Films of a run: what each frame shows, at which pace, and the WebM file."""
