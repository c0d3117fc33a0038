"""Localization Module: robot link, profiles, motion lease, navigation."""
