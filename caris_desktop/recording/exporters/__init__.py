"""Writers of analysis formats."""
