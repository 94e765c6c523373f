"""Foundations that move: travel on a servo, and prescribed motion of the base."""
