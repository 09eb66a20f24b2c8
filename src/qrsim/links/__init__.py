"""Links to other software."""
