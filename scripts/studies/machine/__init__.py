"""Machine: our model against measurements of a real two-link flexible arm."""
