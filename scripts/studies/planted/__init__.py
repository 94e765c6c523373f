"""Planted errors: which single wrong places in the sources the tests notice."""
