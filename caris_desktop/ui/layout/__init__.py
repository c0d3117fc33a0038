"""How panels are arranged: as plain data, and the widgets that show it."""
