"""Random mutations of text (characters, words, numbers, units, lines) and of values in JSON, from a seed."""

import json
import math
import re

CHARACTERS = [
    *"\x00\x07\x1b\x7f\x85\u200b\u202e\ufeff\ufffe", "３", "٣", "é", "\N{TRACTOR}", '"', "'", "[", "]", "{", "}", "=",
    "#", ",", ".", "\\", "\n", "\r", "\t", "-", "+", "e", "_", " ",
]  # fmt: skip
NUMBERS = [
    "0", "-0", "-1", "1", "1e308", "-1e308", "1e-308", "5e-324", "1e400", "nan", "inf", "-inf", "1_000", "0x10", "0b1",
    "1.", "00", "007", "1e", "９", "9" * 50, "9" * 400, "9" * 5000, "1e5", "1e-5", "1e9", "true", "[]", "{}", "''",
    "1979-05-27", "[1,2]", "{a=1}", '"x"', "1e99999999999",
]  # fmt: skip
UNITS = [
    "m", "mm", "deg", "rad", "kg", "s", "kN", "kPa", "m/s", "km/h", "N/m", "N*s/m", "%", "degC", "furlong", "m^2",
    "1/m", "m/0", "", "()", "m(", "**", "mol", "dB", "m^-1", "kn/m", "KN", "µm", "eV", "psi", "m^9^9^9",
    "m**99", "((m^9)^9)^9",
]  # fmt: skip
VALUES = [
    None, 0, -1, 1e308, math.nan, math.inf, "x", "", [], {}, True, [[1]], {"a": 1}, "NaN", "Infinity", "1e400", 10**400,
    "1", "\x1b[2J",
]  # fmt: skip


def mutated(text, rng):
    """Return a text with one to three changes."""
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        text = rng.choice(_MUTATIONS)(text, rng)
    return text


def mutated_json(text, rng):
    """Return JSON text with one to three values changed or left out."""
    data = json.loads(text)
    for _ in range(rng.choice([1, 1, 3])):
        place, key = _somewhere(data, rng)
        if isinstance(place, dict) and rng.random() < 0.2:
            del place[key]
        elif place:
            place[key] = rng.choice(VALUES)
    return json.dumps(data)


def _somewhere(data, rng):
    """Return a dictionary or list inside data, and one of its keys."""
    while True:
        keys = list(data) if isinstance(data, dict) else range(len(data))
        if not keys:
            return data, None
        key = rng.choice(keys)
        if not (isinstance(data[key], dict | list) and data[key] and rng.random() < 0.8):
            return data, key
        data = data[key]


def _replaced(pattern, choose):
    """Return a mutation that replaces one match of a pattern."""

    def change(text, rng):
        found = list(re.finditer(pattern, text))
        if not found:
            return text
        one = rng.choice(found)
        return text[: one.start()] + choose(rng, one[0], found) + text[one.end() :]

    return change


def _misspelt(rng, word, found):
    at = rng.randrange(len(word))
    return rng.choice([word[:at] + word[at + 1 :], word[:at] + word[at:] * 2, word.upper(), rng.choice(found)[0]])


def _spliced(separator, longest):
    """Return a mutation that leaves out a run of a text's parts, or repeats it elsewhere."""

    def change(text, rng):
        parts = text.split(separator) if separator else [*text]
        first, at = rng.randrange(len(parts) + 1), rng.randrange(len(parts) + 1)
        run = parts[first : first + rng.choice(longest)]
        if rng.random() < 0.5:
            return separator.join(parts[:first] + parts[first + len(run) :])
        return separator.join(parts[:at] + run + parts[at:])

    return change


def _with_characters(text, rng):
    at = rng.randrange(len(text) + 1)
    return text[:at] + rng.choice(CHARACTERS) * rng.choice([1, 1, 1, 2, 50]) + text[at:]


def _nested(text, rng):
    lines, deep = text.split("\n"), rng.choice([3, 20, 300, 2000])
    lines.insert(rng.randrange(len(lines)), rng.choice([f"x={'[' * deep}{']' * deep}", f"{'.'.join('a' * deep)}=1"]))
    return "\n".join(lines)


_NUMBER = _replaced(r"(?<![\w.])[-+]?\d+(\.\d+)?(e[-+]?\d+)?", lambda rng, _, __: rng.choice(NUMBERS))
_VALUE = _replaced(r"(?<== )[^\n#,}]+", lambda rng, _, __: rng.choice(NUMBERS))
_UNIT = _replaced(r"(?<=\d )[A-Za-z][\w*/^]*", lambda rng, _, __: rng.choice(UNITS))
_WORD = _replaced(r"[A-Za-z_]{3,}", _misspelt)
_LINES, _LETTERS = _spliced("\n", [1, 1, 2, 20]), _spliced("", [1, 1, 2, 5, 20, 10_000])
_MUTATIONS = [
    _NUMBER, _NUMBER, _VALUE, _UNIT, _UNIT, _WORD, _WORD, _LINES, _LINES, _LETTERS, _LETTERS, _with_characters, _nested,
]  # fmt: skip
