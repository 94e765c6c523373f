"""Learning: what the recipes reach on test episodes, and what each of their means contributes."""
