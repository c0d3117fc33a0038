"""Widgets of the Conversation panel."""
