"""``qrsim identify``: the constants of a vehicle from its flight logs."""
