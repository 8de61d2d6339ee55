"""Criticism of a model: candidates for what it lacks are scored, the best ones fitted, and all forecasts compared."""
