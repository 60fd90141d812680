"""Updates of a filter by tracks (MSCKF)."""
