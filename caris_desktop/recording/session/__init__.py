"""Recorded session folders: reading, repair, verification, and aggregation of events."""
