"""Radio between vehicles."""
