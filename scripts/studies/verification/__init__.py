"""Verification: the full table of expected and computed values, with its reference solutions."""
