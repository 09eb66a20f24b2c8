"""Studies: many conditions flown on all cores or a cluster, and their analysis."""
