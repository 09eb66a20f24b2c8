"""Checks a plan over many seeds before the flight."""
