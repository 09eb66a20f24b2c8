"""Scenario files: data (*.yaml), schema, checks and the way from a scenario to a World."""
