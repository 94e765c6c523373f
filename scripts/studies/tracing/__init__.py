"""Folder that a traced program has in its path: see `sitecustomize`."""
