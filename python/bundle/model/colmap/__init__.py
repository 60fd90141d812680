"""COLMAP models as records: data of files that a problem lacks, and models to be written."""
