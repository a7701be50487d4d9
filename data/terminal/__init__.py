"""How a command speaks with the person at the terminal, and how it ends: light, for every command."""
