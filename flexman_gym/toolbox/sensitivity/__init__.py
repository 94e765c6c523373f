"""Derivatives of simulations and episodes, and design of an arm by them."""
