"""`plough-opt sweep`: evaluation of a file's scene or design over a grid or a sample."""

import argparse
import hashlib
import json
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path

from plough_opt.app.terminal import LOG, give, quiet, read, wrote
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.process import optional
from plough_opt.problem_file.sweep import ProblemSweep, What


def sweep(options: argparse.Namespace) -> None:
    """Simulate or optimise a file at every point of a grid or a sample; resume an interrupted sweep."""
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers}: a sweep needs at least one")
    if options.scheduler is not None and options.workers is not None:
        raise InputError("--workers start on this machine, but --scheduler has its own: remove one of the two")
    if options.scheduler is not None:
        optional("distributed")  # before anything is read
    over = _over(options)
    problem = read(options)
    what: What = "optimise" if options.optimise else "simulate"
    plan = ProblemSweep.of(problem, over, what, options.method, options.samples, options.seed)
    store = options.store or _store_of(options.file, plan)
    notes = list(plan.notes)
    if options.samples is not None and options.samples & (options.samples - 1):
        notes.append(f"{options.samples} samples are not a power of two: a Sobol sample is balanced at 64, 128, ...")
    for note in notes:
        LOG.info("note: %s", note)
    with _executor(options.scheduler) as (executor, workers):
        found = plan.run(
            samples=options.samples,
            seed=options.seed,
            store=store,
            executor=executor,
            workers=workers or options.workers,
            retry=options.retry,
            limit=options.limit,
            progress=not quiet(),
        )
    try:
        give(options, found.page(), found.to_json, found.plot, found.to_dataframe, found.to_csv)
        if options.npz is not None:
            wrote(found.to_npz(options.npz))
        if found.failed == len(found):
            raise NotConverged("every point failed; the reasons are listed above and in the tables", "failed")
        if undetermined := len(list(found.undetermined)):
            raise NotConverged(
                f"{undetermined} of {len(found)} points are undetermined, because workers ended while computing them;"
                " run the same command with --retry to repeat them",
                "undetermined",
            )
    finally:
        found.close()


def _over(options: argparse.Namespace) -> dict[str, object]:
    """Return quantity -> its values as text."""
    fixed = {text.partition("=")[0].strip() for text in options.set}
    over: dict[str, object] = {}
    for text in options.over:
        name, _, written = (part.strip() for part in text.partition("="))
        if not (name and written):
            raise InputError(f'--over {text}: expected KEY=RANGE, like soil.cohesion="5..45 kPa:9"')
        if name in over:
            raise InputError(f"--over {text}: '{name}' is swept twice: remove one")
        if name in fixed:
            raise InputError(f"--over {text}: '{name}' is also fixed by --set: remove one of the two")
        over[name] = written.strip("\"'")  # quotes that a shell left
    return over


def _store_of(file: str, plan: ProblemSweep) -> Path:
    """Return the default store, whose name depends on the question, so that only the same command finds it again."""
    text = json.dumps([dict(plan.question), {name: repr(axis) for name, axis in plan.axes.items()}, plan.count])
    return Path(f"{Path(file).stem}-{hashlib.sha256(text.encode()).hexdigest()[:8]}.sweep.db")


@contextmanager
def _executor(address: str | None) -> Iterator[tuple[Executor | None, int | None]]:
    """Yield the executor of a dask scheduler and the number of its workers' threads; None without an address."""
    if address is None:
        yield None, None
        return
    distributed = optional("distributed")
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {address}: no dask scheduler answers at this address ({error})") from None
    with client:
        threads = sum(client.ncores().values())
        if threads == 0:
            raise InputError(f"--scheduler {address}: it has no workers; start some with: dask worker {address}")
        yield client.get_executor(pure=False), threads
