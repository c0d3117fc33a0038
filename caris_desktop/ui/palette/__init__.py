"""Find anything: what there is to find, how it is found, and the card that it is typed into."""
