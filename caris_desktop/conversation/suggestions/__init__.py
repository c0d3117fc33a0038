"""Suggested replies and proposed actions of the language model, and their outcomes."""
