"""The report's sections on systematic errors that were estimated along."""
