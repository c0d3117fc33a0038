"""Tests of the dock layout."""
