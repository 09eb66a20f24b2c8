"""Programs on top of the library; they are independent of each other."""
