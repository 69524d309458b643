"""plough_opt: design of subsoiler ploughshares by optimisation with exact derivatives."""
