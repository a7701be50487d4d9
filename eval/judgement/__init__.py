"""The judgement of a log and task: made once from all runs and the truth, rendered by every command and page."""
