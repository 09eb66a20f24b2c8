"""Flying a scenario and recording it."""
