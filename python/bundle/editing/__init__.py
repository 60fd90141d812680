"""Models changed before a solve: lenses, sharing, rigs, merging."""
