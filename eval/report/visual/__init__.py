"""The visual lab's section of the report: models, pictures, plan."""
