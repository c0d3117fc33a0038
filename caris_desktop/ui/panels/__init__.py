"""One module per dock panel; panels never import one another."""
