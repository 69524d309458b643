"""A parser that refuses the constants that Python's own JSON parser accepts beyond the standard."""

import json


def strict(text):
    """Return parsed JSON; raise AssertionError for NaN and infinities, which are not JSON."""

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)
