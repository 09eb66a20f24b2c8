"""What a user names: opened safely, YAML read with limits."""
