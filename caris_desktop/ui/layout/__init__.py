"""Dock layout: as plain data, and the widgets that show it."""
