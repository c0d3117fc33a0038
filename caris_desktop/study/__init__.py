"""Participants, conditions and trials."""
