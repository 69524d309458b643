"""Design problems and their true optima, from formulas and searches that share no code with the package under test.

`motion` integrates the equation of motion in C, `problem` turns variables into objective and requirements, `truth`
searches them with SciPy, `study` judges answers, `build` states the problems as a `plough_opt.Design`.
"""
