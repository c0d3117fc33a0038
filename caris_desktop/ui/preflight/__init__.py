"""Preflight checks in the window."""
