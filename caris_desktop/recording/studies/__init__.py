"""Studies: search over many sessions, and statistics."""
