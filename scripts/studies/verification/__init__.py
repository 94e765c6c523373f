"""Verification table of expected and computed values, with reference solutions."""
