"""One module a solver; each runs one request in its own process (see protocol.py)."""
