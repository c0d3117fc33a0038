"""What is said is heard: whose voice it is, where a turn ends, and its words."""
