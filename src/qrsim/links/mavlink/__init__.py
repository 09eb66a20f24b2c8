"""MAVLink: every vehicle of a scenario as a system of its own."""
