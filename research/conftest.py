"""Fixtures of the tests that studies use, too."""

from tests.conftest import mrclam, shared_data

__all__ = ["mrclam", "shared_data"]
