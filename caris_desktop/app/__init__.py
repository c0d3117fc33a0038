"""Composition of a run from its parts; the only package that knows concrete adapters."""
