"""`jcbb-hindsight`: decisions that later frames may revise."""
