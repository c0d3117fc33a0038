"""The guided exercise, and what is kept of it for each wizard."""
