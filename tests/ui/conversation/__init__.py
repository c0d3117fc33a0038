"""The panels one by one, in a window on a fake console."""
