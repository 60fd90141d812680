"""A request becomes a result."""
