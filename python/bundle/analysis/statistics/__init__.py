"""Statistics of a model: counts, tracks, lenses and possible errors (bundle info)."""
