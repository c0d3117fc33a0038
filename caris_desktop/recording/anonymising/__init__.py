"""Copies of sessions without names, faces and voices."""
