"""League: agents compared in the same episodes of several scenarios."""
