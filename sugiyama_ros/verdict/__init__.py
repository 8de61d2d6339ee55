"""What is told of models: models compared without a search."""
