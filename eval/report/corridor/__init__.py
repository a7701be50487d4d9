"""The corridor lab's section of the report: its questions, answered from the runs."""
