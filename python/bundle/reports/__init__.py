"""What a user reads: tables and sentences for people, JSON for programs."""
