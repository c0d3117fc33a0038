"""Conversation: language models, speech recognition, speech synthesis."""
