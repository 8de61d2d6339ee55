"""Live, honest estimation of how people drive."""
