"""What goes over the line: bytes to answers, answers to packets, faults by name, and the recording of it all."""
