"""A whole lab, handed in: its questions answered in order at the top of the report, each with a picture."""
