"""Looking at scenarios and their schema."""
