"""Tests of the Conversation Module."""
