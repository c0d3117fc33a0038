"""Tests of suggestions in the conversation panel."""
