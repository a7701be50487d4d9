"""What a log holds, and questions about it: what looks otherwise than it is stated, and the flag that mends it."""
