"""The Qt window: all widgets and painting."""
