"""File formats, one per file or folder, read strictly: errors name file, line and value."""
