"""Worlds that are flown: one, many, by a policy, open loop; and a state as bytes."""
