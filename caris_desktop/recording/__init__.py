"""Session recorder, session reader and exporters."""
