"""The sheet of all shortcuts, and what a wizard has changed of them."""
