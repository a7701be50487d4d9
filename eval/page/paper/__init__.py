"""Tables for a paper: LaTeX that fits a column or a page as it is, names that people read, fine print apart."""
