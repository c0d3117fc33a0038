"""Tests of what the wizard sees of the checks before a recording."""
