"""How panels are arranged."""
