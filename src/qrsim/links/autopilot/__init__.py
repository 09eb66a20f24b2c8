"""Firmware of autopilots in the loop: their processes, step by step with a simulation."""
