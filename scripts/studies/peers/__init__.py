"""Peers: the same arm in other codes."""
