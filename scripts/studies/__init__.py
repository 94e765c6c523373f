"""Studies that produce the published evidence about the package; the package itself does not import them."""
