"""Results shown: terminal, JSON, HTML pages."""
