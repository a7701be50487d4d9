"""What `python -m eval.benchmark` measures."""
