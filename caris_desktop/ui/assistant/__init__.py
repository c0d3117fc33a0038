"""Widgets of the Assistant panel."""
