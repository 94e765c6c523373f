"""Commands of `flexman`: one file each, which says its `arguments` and does what it is for in `run`."""
