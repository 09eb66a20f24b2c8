"""What a user says to a simulation and sees of it: actions, readings, policies, metrics."""
