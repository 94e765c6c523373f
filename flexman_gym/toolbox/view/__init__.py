"""Pictures, plots, videos, and the live and replay pages."""
