"""The panels of the page, from arrays. Every axis has its unit."""
