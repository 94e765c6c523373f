"""Precision: error of the tip over cost, of all methods and models."""
