"""Programs of `python -m studies`, one file each; the `RUNNER` of a file adds its arguments to a parser and runs it."""
