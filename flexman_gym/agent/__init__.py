"""Agents: controller, action mode, history and normalisation, and policies as networks."""
