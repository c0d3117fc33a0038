"""What is wrong now, as the wizard sees it."""
