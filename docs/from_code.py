"""Parts of pages that the code knows: public names, commands, keys of problem files, and the registries."""

import ast
import inspect
import math
import os
import re
from pathlib import Path

import plough_opt as po
from plough_opt.app.main import parser
from plough_opt.core.quantities import EVERY
from plough_opt.exchange.export.formats import FORMATS
from plough_opt.laws import LAWS
from plough_opt.motion.effects import TERMS
from plough_opt.motion.methods import METHODS
from plough_opt.motion.vocabulary import MEASURES, called
from plough_opt.problem_file import schema

FURTHER = re.compile(r"strength_wave_\d")
HUGE = 1e30  # an end of a domain that only keeps numbers finite

os.environ["COLUMNS"] = "88"  # width of the commands' help


def table(heading, rows):
    """Return a table in Markdown."""
    cells = [[str(cell).replace("|", r"\|") for cell in row] for row in rows]
    lines = [heading, ["---"] * len(heading), *cells]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def first_line(thing):
    """Return the first line of a docstring."""
    return inspect.getdoc(thing).splitlines()[0]


def public(place):
    """Return the public names of a room such as "soil", or of a module such as "plough_opt.plastic"."""
    if place.startswith("plough_opt."):
        name = place.removeprefix("plough_opt.")
        module = getattr(po, name)
        # A name that belongs to the package too, or to the laws, is described there.
        others = [one for one in (po, po.laws) if one is not module]
        own = [one for one in module.__all__ if all(getattr(o, one, None) is not getattr(module, one) for o in others)]
        return [(f"{name}.{one}", getattr(module, one)) for one in own]
    stub = ast.parse(Path(po.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    lines = [one for one in stub.body if isinstance(one, ast.ImportFrom) and (one.module or "").split(".")[0] == place]
    found = [(alias.name, getattr(po, alias.name)) for line in lines for alias in line.names]
    return [(name, thing) for name, thing in found if not inspect.ismodule(thing)]


def kind_of(thing):
    """Return the kind of a name that autodoc knows."""
    if inspect.isclass(thing):
        return "exception" if issubclass(thing, BaseException) else "class"
    return "function" if inspect.isroutine(thing) else "data"


def names(place):
    """Return the documentation of all public names of a room or a module."""
    parts = []
    for name, thing in public(place):
        module, _, last = name.rpartition(".")
        # Only the module that defines a number or table has its description.
        home = getattr(po, module).__name__ if kind_of(thing) == "data" else f"plough_opt.{module}".rstrip(".")
        parts.append(f".. auto{kind_of(thing)}:: {home}.{last}\n")
    return "```{eval-rst}\n.. py:currentmodule:: plough_opt\n\n" + "\n".join(parts) + "```\n"


def commands():
    """Return the help of every command."""
    verbs = next(one for one in parser()._actions if isinstance(one.choices, dict))
    helps = {one.dest: one.help for one in verbs._choices_actions}
    parts = [(name, verb) for name, verb in verbs.choices.items() if name in helps]
    return "\n".join(
        f"## {name}\n\n{helps[name].capitalize()}.\n\n```text\n{verb.format_help()}```\n" for name, verb in parts
    )


def domain(one):
    """Return the ends of a quantity's domain, angles in degrees."""

    def written(end):
        return f"{math.degrees(end):.4g}°" if one.unit == "rad" else f"{end:.4g}"

    above = f"{'above' if one.above else 'at least'} {written(one.low)}" if one.low > -math.inf else ""
    below = f"{'below' if one.below else 'at most'} {written(one.high)}" if one.high < HUGE else ""
    return ", ".join(filter(None, (above, below)))


# Heading of a table of a problem file -> its schema, and the owner of its quantities.
KEYS = {
    "[soil]": ("SoilFile", "soil"),
    "compaction in [soil]": ("CompactionTable", ""),
    "[share]": ("ShareFile", "share"),
    "[scene]": ("SceneFile", "scene"),
    "[effects]": ("EffectsFile", "effects"),
    "strength_wave in [effects]": ("StrengthWaveFile", "effects.strength_wave"),
    "random_strength in [effects]": ("RandomStrengthFile", "effects.random_strength"),
    "[accuracy]": ("AccuracyTable", ""),
    "A quantity in [variables]": ("VariableTable", ""),
    "A result in [minimise]": ("TermTable", ""),
    "A result in [require]": ("LimitTable", ""),
}


KINDS = {
    "boolean": "true or false", "integer": "whole number", "string": "text", "number": "number", "array": "list",
}  # fmt: skip


def value_of(about, quantity):
    """Return what a key of the schema takes, in words."""
    if quantity:
        unit = quantity.shown or quantity.unit
        return f"text with a unit, such as {unit}" if unit else "number"
    names = about.get("enum") or next((one["enum"] for one in about.get("anyOf", ()) if "enum" in one), ())
    if names:
        return ", ".join(f'`"{one}"`' for one in names) + ("" if "enum" in about else ", or a table")
    if "$ref" in about:
        return "table"
    return KINDS.get(about.get("type"), "number, or text with a unit")


def shown(default):
    """Return a default value as a file has it."""
    if default in ("", None, []):
        return ""
    return f"`{str(default).lower() if isinstance(default, bool) else default}`"


def described():
    """Return the descriptions in the docstrings of the schema's tables, by table and key."""
    found = {}
    for name, table in inspect.getmembers(schema, lambda member: member in schema.Table.__subclasses__()):
        for key, meaning in re.findall(r"^    (\w+): (.+)$", inspect.getdoc(table) or "", flags=re.MULTILINE):
            found[name.removesuffix("Table"), key] = meaning
    return found


def keys():
    """Return every key of a problem file, table by table."""
    whole, told, parts = schema.file_schema(), described(), []
    defs = whole["$defs"]

    def rows_of(kind, owner):
        rows = []
        for key, about in defs[kind]["properties"].items():
            quantity = EVERY.get(f"{owner}.{key}")
            short = kind.removesuffix("File").removesuffix("Table")
            meaning = about.get("description") or told.get((short, key)) or "described below"
            limits = domain(quantity) if quantity else ""
            rows.append((f"`{key}`", meaning, value_of(about, quantity), limits, shown(about.get("default"))))
        return rows

    for title, (kind, owner) in KEYS.items():
        rows = [row for row in rows_of(kind, owner) if not FURTHER.search(row[0])]
        parts.append(f"## {title}\n\n" + table(("key", "meaning", "value", "domain in SI", "default"), rows))
    return "\n".join(parts)


def quantities():
    """Return the quantities of a scene, of the strength waves the first."""
    rows = [
        (f"`{name}`", one.meaning, one.unit or "1", domain(one))
        for name, one in EVERY.items()
        if not FURTHER.search(name)
    ]
    return table(("quantity", "meaning", "SI unit", "domain in SI"), rows)


def measures():
    """Return the results of a run."""
    rows = [
        (f"`{name}`", one.unit.symbol or "1", called(name), "every output" if one.everywhere else "the run")
        for name, one in MEASURES.items()
    ]
    return table(("result", "SI unit", "meaning", "value for"), rows)


def laws():
    """Return the laws of resistance."""
    return table(
        ("name", "class", "law"),
        [(f"`{name}`", f"`laws.{law.__name__}`", first_line(law)) for name, law in LAWS.items()],
    )


def effects():
    """Return the effects."""
    rows = [(f"`{term.field}`", term.label, first_line(term)) for term in TERMS if term.label and term.field]
    return table(("field of `Effects`", "name", "effect"), rows)


def formats():
    """Return the export formats."""
    rows = [
        (
            f"`{name}`",
            one.what,
            ", ".join(f"`{end}`" for end in one.endings) or "folder",
            ", ".join(f"`--{option}`" for option in one.options),
        )
        for name, one in FORMATS.items()
    ]
    return table(("`--to`", "what is written", "file", "options"), rows)


def methods():
    """Return the integration methods."""
    rows = [
        (f"`{name}`", "tolerance" if one.adaptive else "steps", one.order or "", "yes" if one.locates_events else "")
        for name, one in METHODS.items()
    ]
    return table(("method", "setting", "order", "locates events"), rows)


PARTS = {one.__name__: one for one in (names, commands, keys, quantities, measures, laws, effects, formats, methods)}
