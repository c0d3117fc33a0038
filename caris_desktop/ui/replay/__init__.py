"""Replay widgets: replay bar and annotation timeline."""
