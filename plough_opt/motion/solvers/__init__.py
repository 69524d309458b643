"""How the equation of motion is solved: steps, CasADi's integrators, orbits, machine code, derivatives and checks."""
