"""Wiring: composes a run from its parts; the only room that knows concrete adapters."""
