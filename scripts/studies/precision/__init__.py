"""Work-precision study: tip error against cost for all methods and models."""
