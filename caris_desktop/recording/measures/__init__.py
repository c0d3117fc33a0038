"""Measures of sessions: their definitions, and their values."""
