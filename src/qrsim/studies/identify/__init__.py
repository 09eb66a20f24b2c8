"""Constants of a vehicle from its flight logs, by non-linear least squares."""
