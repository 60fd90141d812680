"""Terminal tables and JSON data of each command."""
