"""One world of fleets: its parameters, its state, and the order of a tick."""
