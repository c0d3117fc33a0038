"""Widgets of the Speak panel."""
