"""Questions about a log: what looks otherwise than it is stated, and the flag that mends it."""
