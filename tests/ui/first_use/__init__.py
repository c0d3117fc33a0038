"""Tests of the first-use page."""
