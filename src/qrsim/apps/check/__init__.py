"""Checking a plan over many seeds before it is flown."""
