"""Tests of suggestions and proposals."""
