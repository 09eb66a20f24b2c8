"""Files: what a user names is opened safely, YAML is read with limits, what is written appears whole or not at all."""
