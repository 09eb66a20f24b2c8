"""Flight of worlds: one, many, by a policy, open loop; and states as bytes."""
