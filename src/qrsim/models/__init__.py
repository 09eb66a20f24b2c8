"""Models of physical things, a folder for each part of the outdoors; they import only core, files and errors."""
