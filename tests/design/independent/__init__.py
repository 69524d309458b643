"""Design problems and their true optima, from formulas and searches that share no code with the package under test.

`motion` integrates the equation of motion with NumPy, `problem` turns variables into objective and requirements,
`generate` draws problems, `truth` searches them with SciPy, `build` states them as a `plough_opt.Design`.
"""
