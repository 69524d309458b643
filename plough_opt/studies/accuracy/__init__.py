"""Cost of accuracy: error against time of every method that can simulate a scene or solve a design."""
