"""Every file of the result folder and every column in it, said once: the writers and docs/results-folder.md use it."""
