"""Shortcut sheet, and the wizard's own key bindings."""
