"""Side by side measurement of bundle and its peers; see README.md."""
