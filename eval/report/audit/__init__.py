"""The audit of a factor graph for a person: tables and words, its page, and its part of a log's page."""
