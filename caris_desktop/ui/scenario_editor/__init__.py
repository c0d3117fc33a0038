"""The editor of scenario files: a form made from the declarations, what comes of each change, and the text itself."""
