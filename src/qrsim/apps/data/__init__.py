"""Fetching the public recordings."""
