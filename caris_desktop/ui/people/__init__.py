"""People widgets: panel rows, portraits, person popup."""
