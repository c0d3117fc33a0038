"""Scenario files: schema, loading, editing, sharing."""
