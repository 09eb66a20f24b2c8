"""Vehicles, one per file."""
