"""Sensors of vehicles, and their faults."""
