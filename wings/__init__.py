"""Wings beside the core: each has its formats, front ends, scores, sections and commands, and an object `wing`."""
