"""Features that the core does not import: each room names what it is for."""
