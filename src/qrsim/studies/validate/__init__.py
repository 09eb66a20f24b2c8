"""Validation of the models against recordings and closed forms."""
