"""One world of fleets: what it is made of, what changes in it, and the order of a tick."""
