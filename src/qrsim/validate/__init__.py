"""The models against recordings and closed forms."""
