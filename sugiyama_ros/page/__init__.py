"""The page: what was measured, what the model says, where the model fails, and what is missing."""
