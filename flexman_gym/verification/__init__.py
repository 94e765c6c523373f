"""Verification: closed-form solutions beside the values that this package computes."""
