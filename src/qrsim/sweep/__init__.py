"""Studies: many conditions on all cores or a cluster, and what comes of them."""
