"""Exact derivatives of motions and episodes against differences."""
