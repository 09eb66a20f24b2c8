"""The area and its contents: limits, obstacles, ground cover, plume, persons, starts of vehicles."""
