"""Satellites, the errors of their ranges, and receivers."""
