"""Observer window: read-only second window."""
