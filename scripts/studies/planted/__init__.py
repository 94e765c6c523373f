"""Planted errors: mutation testing of the test suite."""
