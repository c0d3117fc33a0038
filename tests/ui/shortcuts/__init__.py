"""Tests of the shortcut sheet and of changed keys."""
