"""How logs and runs show themselves in a notebook."""
