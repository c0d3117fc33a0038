"""Command palette (Find anything): items, search and popup."""
