"""The page: what was measured, what the model says of it, where it fails, what is missing."""
