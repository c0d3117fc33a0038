"""A second window for whoever looks on: it shows, and can ask for nothing."""
