"""Widgets of the protocol strip."""
