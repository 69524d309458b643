"""Files and folders that are written whole, or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from plough_opt.errors import InputError


def check_folder(path: str | Path, kind: str) -> Path:
    """Return the path of a folder to be written.

    Raises:
        InputError: it is there already.
    """
    target = Path(path)
    if target.exists() or target.is_symlink():
        raise InputError(f"'{target}' exists already and is left as it is: name a new folder for the {kind}")
    return target


def check_file(path: str | Path, ending: str, kind: str) -> Path:
    """Return the path of a file to be written.

    Raises:
        InputError: another ending, or a folder.
    """
    target = Path(path)
    if target.suffix.lower() != ending:
        raise InputError(f"'{target}' is no name for the {kind}: end it in {ending}")
    if target.is_dir():
        raise InputError(f"'{target}' is a folder: name a file in it")
    return target


def write_folder(target: Path, files: Mapping[str, bytes]) -> Path:
    """Write files into a new folder, making the folders around it.

    Raises:
        InputError: a place that cannot be written.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
        try:
            for name, content in files.items():
                (scratch / name).write_bytes(content)
            # What mkdtemp makes is the user's alone.
            scratch.chmod(0o777 & ~_umask())
            scratch.rename(target)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise InputError(f"the folder '{target}' cannot be written: {error.strerror}") from None
    return target


def write_files(files: Mapping[Path, bytes]) -> None:
    """Write files, making their folders; none is moved to its place before all are written.

    Raises:
        InputError: a place that cannot be written.
    """
    partial = {target: target.with_name(f".{target.name}.{os.getpid()}") for target in files}
    target = next(iter(files))
    try:
        try:
            for target, content in files.items():
                target.parent.mkdir(parents=True, exist_ok=True)
                partial[target].write_bytes(content)
            for target in files:
                partial[target].replace(target)
        finally:
            for part in partial.values():
                part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"'{target}' cannot be written: {error.strerror}") from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
