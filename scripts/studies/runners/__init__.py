"""Programs that run the studies, one file each."""
