"""The model of a design: split around its runs, as a scaled program with exact derivatives, and as a population."""
