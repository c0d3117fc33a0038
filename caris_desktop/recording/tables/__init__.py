"""Tidy tables of a session, for exports, measures and the guide."""
