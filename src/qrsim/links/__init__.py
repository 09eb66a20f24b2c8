"""To other software."""
