"""One vehicle driven by the commands of a CSV file: no world, no sensors, no noise."""
