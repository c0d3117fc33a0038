"""The words everything speaks."""
