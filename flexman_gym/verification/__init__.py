"""Verification: numbers that are known from elsewhere, beside what the package computes."""
