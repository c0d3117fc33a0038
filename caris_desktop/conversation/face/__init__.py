"""Robot face: face files, animation, and drawing."""
