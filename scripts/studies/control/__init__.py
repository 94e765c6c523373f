"""Control: what controllers do on arms that nobody knows, and what breaks them."""
