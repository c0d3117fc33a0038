"""Scenario editor: a form generated from the schema, a preview of consequences, and the YAML text."""
