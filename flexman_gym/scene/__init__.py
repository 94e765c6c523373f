"""Scene: descriptions of an arm, its drive and its initial state, and their files."""
