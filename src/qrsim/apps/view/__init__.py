"""Looking at recorded runs in three dimensions."""
