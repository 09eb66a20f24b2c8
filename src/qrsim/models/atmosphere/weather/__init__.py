"""Readers of weather models' files; ``soundings.py`` makes a wind over height of what they read. Read that first."""
