"""Association judged on a variety of simulated worlds: its runs, its goals and its figure."""
