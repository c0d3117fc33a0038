"""Tests of the conversation package."""
