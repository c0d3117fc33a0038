"""The sheet of all shortcuts, and changed keys."""
