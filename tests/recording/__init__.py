"""Recording, tested through the real process and real files."""
