"""How what the referee knows shows itself in a notebook."""
