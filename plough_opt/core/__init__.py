"""Ground: expressions, quantities and their units, domains, errors, files, the compiler."""
