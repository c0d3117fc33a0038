"""The robot link."""
