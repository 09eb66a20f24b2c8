"""Models of physical things, one per file; they import only qrsim.core and qrsim.errors."""
