"""Mathematics under the simulator; imports only jax and numpy."""
