"""Cost of accuracy: error against time for every method that can simulate a scene or solve a design."""
