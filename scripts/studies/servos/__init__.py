"""Stability limits of joint servo loops."""
