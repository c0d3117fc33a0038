"""Tests of the preflight checks in the window."""
