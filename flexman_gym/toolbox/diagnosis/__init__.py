"""Diagnosis of the tip error after arrival."""
