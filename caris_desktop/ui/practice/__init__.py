"""Guided practice, and its results per wizard."""
