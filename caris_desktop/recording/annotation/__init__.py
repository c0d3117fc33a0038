"""Annotations: tiers, vocabularies, editing, agreement, import."""
