"""``qrsim discover``: the form of a vehicle's equations from a flight log, by co-evolutionary programming."""
