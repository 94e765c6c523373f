"""Test oracles that are independent of the code under test, and random arms."""
