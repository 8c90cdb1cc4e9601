"""Random scenes, what must be true of their answers, and how to look at one of them."""
