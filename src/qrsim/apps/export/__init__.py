"""Recorded runs in the formats of other programs: tables, maps, GPS tools, globes and robot viewers."""
