"""Estimators and ways of association that are not ours: where they are, loaded, and given the verbs they lack.

Everywhere else they are a text, `NAME=FILE:ATTRIBUTE` or `NAME=MODULE:ATTRIBUTE`, which any process can load.
"""
