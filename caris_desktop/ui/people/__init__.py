"""What the window shows of people: the rows of the panel, portraits, the card of one person."""
