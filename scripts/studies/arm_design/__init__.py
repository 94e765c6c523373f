"""Study of arms whose thickness is optimised."""
