"""Interface to users: actions, readings, policies, metrics."""
