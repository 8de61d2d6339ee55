"""Standard messages of each driver, for others to use: one file for each output."""
