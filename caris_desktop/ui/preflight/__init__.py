"""The checks before a recording, as the wizard sees them."""
