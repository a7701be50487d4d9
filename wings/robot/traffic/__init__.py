"""The line's traffic: bytes to answers, answers to packets, faults by name, and its recording."""
