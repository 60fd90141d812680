"""Output of results: terminal tables, JSON, HTML pages."""
