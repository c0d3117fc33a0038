"""Forgetting a person: nothing of a study's recordings shows or names them afterwards, and a search proves it."""
