"""Tables and JSON of each command."""
