"""Models of physical things, a folder for each part of the outdoors; they import only qrsim.core and qrsim.errors."""
