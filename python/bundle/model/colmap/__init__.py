"""COLMAP models as records: what files hold beside a problem, and models to be written."""
