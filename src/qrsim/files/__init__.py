"""Users' files: opened safely, YAML read with limits."""
