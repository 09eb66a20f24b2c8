"""Laws of a vehicle from its flight logs, by co-evolution."""
