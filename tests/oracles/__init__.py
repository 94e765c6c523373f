"""Oracles: what tests compare with, made without the code that they judge, and the arms that they make up."""
