"""Pictures of problems, orderings and solves."""
