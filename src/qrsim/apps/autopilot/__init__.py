"""``qrsim autopilot``: vehicles flown by the firmware of an autopilot."""
