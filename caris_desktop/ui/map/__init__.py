"""Map: view, graphics items, tools."""
