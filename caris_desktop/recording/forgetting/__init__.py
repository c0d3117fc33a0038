"""Erasure of a person from a study's recordings, verified by a search."""
