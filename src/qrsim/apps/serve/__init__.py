"""A live simulation for clients over TCP."""
