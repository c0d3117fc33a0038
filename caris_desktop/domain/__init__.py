"""Domain types and formats shared by all packages."""
