"""What accuracy costs: error against time for every method that can do a scene or a design."""
