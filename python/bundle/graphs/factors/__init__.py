"""Factor graphs: variables on manifolds, factors between them, one solve."""
