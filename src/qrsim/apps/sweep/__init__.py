"""Studies of many conditions: planned lazily, flown on all cores or a cluster, kept in a store, summed up."""
