"""Figures as a paper wants them: width, type, and text that LaTeX can set."""
