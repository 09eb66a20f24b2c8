"""Holding the models against recordings, closed forms and independent implementations."""
