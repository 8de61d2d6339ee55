"""Live, honest estimation of how people drive."""

from sugiyama_ros import compiled_cache

compiled_cache.choose()
