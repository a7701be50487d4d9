"""The report: sections, and the files of the result folder."""
