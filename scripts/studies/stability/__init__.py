"""Stability: where methods fail, and what they damp."""
