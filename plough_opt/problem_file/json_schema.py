"""JSON schema of problem files, with which editors complete keys and mark mistakes."""

from collections.abc import Iterable
from typing import Any

from plough_opt.core.quantities import EVERY, IN_FILES
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file.schema import SHARE_TABLES, LimitTable, ProblemFile, TermTable, VariableTable

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def file_schema() -> dict[str, Any]:
    """Return the JSON schema of a problem file: its tables and keys, with their meanings and an example of each unit.

    The schema describes each key by itself. Only `read_problem` finds contradictions between keys, such as a variable
    that also has a fixed value.

    Example:
        >>> from plough_opt.problem_file.json_schema import file_schema
        >>> file_schema()["properties"]["title"]["type"]
        'string'
    """
    schema = ProblemFile.model_json_schema()
    single = [name for name, measure in MEASURES.items() if not measure.everywhere]
    definitions, tables = schema["$defs"], schema["properties"]
    for table in (VariableTable, TermTable, LimitTable):
        definitions[table.__name__] = table.model_json_schema()
    tables["variables"] = _of(IN_FILES, "VariableTable", {name: EVERY[name].meaning for name in IN_FILES})
    tables["minimise"] = _of(single, "TermTable", others=True)
    tables["minimise"]["properties"]["over"] = {"enum": ["worst", "mean"]}
    tables["require"] = _of(MEASURES, "LimitTable", others=True)
    goal = {"type": "object", "properties": {"maximise": {"type": "boolean"}}, "additionalProperties": False}
    tables["trade_off"] = {
        "type": "object",
        "properties": dict.fromkeys(single, goal) | {"points": {"type": "integer", "minimum": 5, "maximum": 1000}},
        "additionalProperties": goal,  # results defined in [measures]
    }
    tables["uncertain"] = {"type": "object"}
    # A share inherits what its own table omits, so even the bounds of its variables are optional.
    definitions["VariableOfShare"] = {k: own for k, own in definitions["VariableTable"].items() if k != "required"}
    own = {name: {"$ref": f"#/properties/{name}"} for name in SHARE_TABLES}
    own["variables"] = _of(IN_FILES, "VariableOfShare")
    share = {"type": "object", "properties": own, "additionalProperties": False}
    tables["shares"] = {"type": "object", "additionalProperties": share}
    return {"$schema": _DIALECT, **_without_null(schema), "title": "plough_opt problem file"}


def _without_null(schema: Any) -> Any:
    """Return a schema without null, which pydantic allows for optional keys but TOML does not have."""
    if isinstance(schema, list):
        return [_without_null(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: _without_null(part) for key, part in schema.items() if (key, part) != ("default", None)}
    rest = [part for part in found.get("anyOf", ()) if part != {"type": "null"}]
    if len(rest) == 1:
        del found["anyOf"]
        return rest[0] | found
    return found | ({"anyOf": rest} if rest else {})


def _of(
    names: Iterable[str], table: str, meanings: dict[str, str] | None = None, *, others: bool = False
) -> dict[str, Any]:
    """Return the schema of a table that maps names to tables of one kind.

    Args:
        names: valid names; a dotted name may also be written as nested tables.
        table: name of the kind of table among the definitions.
        meanings: name -> description.
        others: whether other names are valid too.
    """
    described = {name: {"description": text} for name, text in (meanings or {}).items()}
    properties: dict[str, Any] = {name: {"$ref": f"#/$defs/{table}"} | described.get(name, {}) for name in names}
    outer = {name.partition(".")[0] for name in properties if "." in name}
    return {
        "type": "object",
        "properties": properties | {name: {"type": "object"} for name in sorted(outer)},
        "additionalProperties": {"$ref": f"#/$defs/{table}"} if others else False,
    }
