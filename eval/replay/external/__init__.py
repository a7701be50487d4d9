"""Foreign estimators and association methods: located, loaded, and completed by an adapter.

Elsewhere they are a text, `NAME=FILE:ATTRIBUTE` or `NAME=MODULE:ATTRIBUTE`, which any process can load.
"""
