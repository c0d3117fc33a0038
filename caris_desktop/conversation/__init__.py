"""Conversation Module: language models and speech."""
