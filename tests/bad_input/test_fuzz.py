"""Thousands of wrong inputs: each is answered by a message with its place and a remedy, never by a traceback.

A warning counts as a failure. Every case is seeded by its number."""

import json
import math
import random
import re
import shutil

import pytest
from helpers.commands import call, printed
from helpers.problem_files import PROBLEMS, SUBSOILER

import plough_opt as po
from plough_opt.core.quantities import quantities

# --- random mutations of text (characters, words, numbers, units, lines) and of values in JSON, from a seed ---

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


# --- thousands of wrong inputs: each is answered by a message with its place and a remedy, never by a traceback ---
# A warning counts as a failure. Every case is seeded by its number.

TEXTS = [path.read_text(encoding="utf-8") for path in sorted(PROBLEMS.glob("*.toml"))]
TABLES = [
    (PROBLEMS / "synthetic_draft.csv").read_text(encoding="utf-8"),
    "scene.tow_speed [km/h]; mean_draft [kN]; sigma [%]\n3; 2.5; 10\n4; 3; 5\n",
    "time [s],mount_force [kN]\n0,1\n0.1,1.1\n0.2,1.2\n0.3,1\n",
]
RECORDS = [
    "position [m],cone_index [kPa]\n" + "".join(f"{0.05 * k:.2f},{1500 + 300 * (k % 7)}\n" for k in range(40)),
    "position [m]; force [kN]\n" + "".join(f"{0.1 * k:.1f}; {3 + 0.4 * (k % 5):.1f}\n" for k in range(36)),
    "time [s],force [N]\n" + "".join(f"{0.1 * k:.1f},{3000 + 90 * (k % 9)}\n" for k in range(36)),
]
KEYS = [
    *quantities(), "title", "minimise.mean_draft.per", "require.half_angle.at_most", "variables.share.height.upper",
    "variables.share.height", "accuracy.method", "accuracy.error", "accuracy.steps", "effects.contact",
    "effects.motion", "effects.orbit", "scene.medium", "scene.outputs", "effects.start",
    "effects.entry", "soil.name", "effects", "uncertain.samples", "trade_off.points", "variables", "minimise",
    "effects.strength_wave", "effects.random_strength", "effects.random_strength.record",
]  # fmt: skip
# Words that show where a mistake is, and what is valid instead.
PLACE = re.compile(r"FILE(, line \d+|, insertion|:|' is not|' cannot be read|' is too long)|--set |problems/cotton")
REMEDY = re.compile(
    r"did you mean|valid names|\b(write|must|give|take|use|leave|omit|remove|name|add|lower|raise|join|merge|set|check"
    r"|belongs?|outside its bounds|contradict|expected|known|needs?|needed|make|least|cannot be|say|choose"
    r"|number|replace|shorten|split|folder contains)\b"
)


def judge(status, message):
    """Assert that an answer is a success, or a message with place and remedy."""
    assert status in (0, 2), message
    if status == 2:
        assert PLACE.search(message), message
        for line in message.removeprefix("bad input: ").splitlines():
            assert REMEDY.search(line) or re.match(r"\.\.\. and \d+ more", line), message


def answered(verb, *arguments):
    """Run a command; return status and message."""
    done = call(verb, *arguments)
    assert done.status == 0 or done.out == ""
    return done.status, done.err


def refused(read, path):
    """Return status and message of reading a file in Python."""
    try:
        read(path)
    except po.InputError as error:
        return 2, str(error)
    return 0, ""


def run(count, answer, folder):
    """Judge the answers to seeded cases, of which at least a quarter must be refusals."""
    refusals = 0
    for number in range(count):
        status, message = answer(random.Random(number), folder / "case")
        try:
            judge(status, message.replace(str(folder / "case"), "FILE"))
        except AssertionError as error:
            raise AssertionError(f"case {number}: {error}") from None
        refusals += status == 2
    assert refusals > count / 4


def thinned(few, many):
    """Parametrise by the number of cases: few by default, many in the slow tests."""
    return pytest.mark.parametrize("count", [few, pytest.param(many, marks=pytest.mark.slow)])


@thinned(70, 2000)
def test_problem_files(count, tmp_path):
    for name in ("insertions.csv", "transect.csv"):
        shutil.copy(PROBLEMS / name, tmp_path)

    def answer(rng, path):
        path.write_text(mutated(rng.choice(TEXTS), rng), encoding="utf-8", errors="surrogatepass", newline="")
        return answered("check", path)

    run(count, answer, tmp_path)


@thinned(40, 500)
def test_changes_on_the_command_line(count, tmp_path):
    def change(rng):
        key = rng.choice(KEYS)
        symbol = quantities()[key].symbol if key in quantities() else rng.choice(UNITS)
        number = rng.choice(NUMBERS)
        written = f"{key}={rng.choice([number, f'{number} {rng.choice(UNITS)}', f'{number} {symbol}', f'1 {symbol}'])}"
        return (mutated(written, rng) if rng.random() < 0.5 else written).replace("\0", "")

    def answer(rng, _):
        changes = [change(rng) for _ in range(rng.choice([1, 1, 2]))]
        return answered("check", SUBSOILER, *(f"--set={text}" for text in changes))

    run(count, answer, tmp_path)


INSERTIONS, TRANSECT = ((PROBLEMS / name).read_text(encoding="utf-8") for name in ("insertions.csv", "transect.csv"))


READINGS = [
    (TABLES, po.read_measurements),
    ([INSERTIONS], lambda file: po.read_penetrometer(file, (0.25, 0.45)).mean),
    ([TRANSECT, *RECORDS], lambda file: po.strength_spectrum(po.read_strength_record(file, tow_speed=1.4))),
]


@pytest.mark.parametrize(("texts", "read"), READINGS, ids=["measurements", "penetrometer", "strength along a path"])
@thinned(30, 300)
def test_tables_of_readings(count, texts, read, tmp_path):
    def changed(rng, path):
        path.write_text(mutated(rng.choice(texts), rng), encoding="utf-8", errors="surrogatepass", newline="")
        return refused(read, path)

    run(count, changed, tmp_path)


SHORT = ("--set=scene.duration=0.1 s", "--set=scene.outputs=10")
RUN = ("simulate", SUBSOILER, *SHORT, "--json")
SAVED = [
    RUN,
    ("optimise", PROBLEMS / "reference.toml", *SHORT, "--sensitivity", "--json"),
    ("tradeoff", PROBLEMS / "draft_against_loosening.toml", "--points=5", "--json"),
    ("optimise", PROBLEMS / "uncertain_field.toml", "--set=uncertain.samples=8", *SHORT, "--json"),
    ("calibrate", PROBLEMS / "calibration.toml", f"--data={PROBLEMS / 'synthetic_draft.csv'}", "--json"),
]


@pytest.mark.parametrize(("count", "commands"), [(40, [RUN]), pytest.param(200, SAVED, marks=pytest.mark.slow)])
def test_saved_results(count, commands, tmp_path):
    texts = [printed(*command) for command in commands]

    def answer(rng, path):
        text = rng.choice(texts)
        text = mutated_json(text, rng) if rng.random() < 0.6 else mutated(text, rng)
        path.write_text(text, encoding="utf-8", errors="surrogatepass", newline="")
        return refused(po.load, path)

    run(count, answer, tmp_path)
