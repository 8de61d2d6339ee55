"""A benchmark away from home: recordings of a generator that shares no formula with the package's simulator."""
