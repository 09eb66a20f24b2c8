"""What is in the area: its limits, obstacles, ground cover, plume, persons, and where vehicles start."""
