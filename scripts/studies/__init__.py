"""Studies: published evidence about the package, which nothing in it imports."""
