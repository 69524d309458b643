"""`sweep`: a function of named numbers over a grid or a sample."""

import hashlib
import inspect
import pickle
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from plough_opt.core.checks import check_switch, path_of, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.core.process import available, heartbeat
from plough_opt.core.saving import versions
from plough_opt.studies.sweep.cluster import Cluster
from plough_opt.studies.sweep.database import About, check_columns
from plough_opt.studies.sweep.engine import Engine, Progress
from plough_opt.studies.sweep.points import axis_of, points_of
from plough_opt.studies.sweep.pool import ProcessPool
from plough_opt.studies.sweep.result import Sweep
from plough_opt.studies.sweep.store import Store
from plough_opt.studies.sweep.work import Evaluation, ManyPoints


def sweep(
    evaluation: Evaluation,
    over: Mapping[str, object],
    *,
    samples: int | None = None,
    seed: int = 0,
    store: str | Path | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    retry: bool = False,
    progress: bool | Progress = False,
    question: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Sweep:
    """Evaluate a function at every point of a grid or a sample, and store what it returns.

    The numbers are the same, bit for bit on one machine, whatever the executor and the number of workers: a point is
    computed from its own values alone.

    Args:
        evaluation: called with a dictionary of the quantities at a point; returns named finite numbers, the same names
            at every point. An error that it raises is the reason of a point that failed. It must be picklable.
        over: name -> `Range`, or a list of numbers. All SI, if the function's arguments are.
        samples: number of points of a scrambled Sobol sample of the ranges instead of a grid, best a power of two.
        seed: of the sample.
        store: an SQLite file, in which every finished point is stored at once. Points of the same question that it
            holds are not repeated; several runs may fill it at the same time. None: a file that is deleted with the
            result.
        executor: any `concurrent.futures.Executor`, such as that of a dask client or of mpi4py; it is left running.
            Default: processes on all cores of this machine, which end with the sweep.
        workers: number of workers of the executor, so that all have work (default: the cores of this machine).
        retry: try the points again that failed, are undetermined, or whose rows in the store are damaged.
        progress: True: a bar on the error stream, if that is a terminal; or a function that is called with the numbers
            of points that are stored, of all points, and of those that failed.
        question: everything else that the results depend on, as texts; a store with other ones is refused.
        units: name -> unit, of quantities and results, for the headings of tables.

    Raises:
        InputError: arguments that cannot be swept; a store of another question, or one that is damaged or loses rows; a
            broken executor, or workers that all die.
        KeyboardInterrupt: interrupted; the message gives the number of stored points.
    """
    _check_arguments(evaluation, over, executor, workers, units)
    check_switch("retry", retry)
    points = points_of({name: axis_of(name, given) for name, given in over.items()}, samples, seed)
    check_columns(points.names)
    whole = {**points.question(), **(question or _identity(evaluation)), **_versions()}
    store = None if store is None else path_of("the store", store)
    if not retry and store is not None and (finished := _finished(store, whole)) is not None:
        return finished
    kept = Store(store)
    try:
        about = About.model_construct(
            names=points.names, results=(), units=dict(units or {}), question=whole, count=points.count, next=0
        )
        kept.prepare(about, retry)
        already = kept.counts().stored
        count = workers or available()
        if already < points.count:
            with ExitStack() as stack:
                callback = progress if callable(progress) else lambda *_: None
                if progress is True:
                    callback = stack.enter_context(bar(Console(stderr=True)))
                if executor is None:
                    used: Executor = stack.enter_context(ProcessPool(count, evaluation))
                else:
                    used = Cluster.of(executor) or executor
                Engine(evaluation, points, kept, used, count, callback).run()
        kept.finish()
    except KeyboardInterrupt:
        done = kept.counts().stored
        kept.close()
        where = "lost, as they had no store" if store is None else f"in '{store}': the same sweep continues from there"
        raise KeyboardInterrupt(f"{done} of {points.count} points are {where}") from None
    except BaseException:
        kept.close()
        raise
    return Sweep(kept, already)


@contextmanager
def bar(console: Console) -> Iterator[Progress]:
    """Show the progress of a sweep, by a bar on a terminal and else by lines; yield the function that updates it."""
    if not console.is_terminal:
        with heartbeat(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True)) as note:
            yield lambda stored, count, failed: note(
                f"sweep: {stored} of {count} points{f', {failed} failed' if failed else ''}"
            )
        return
    columns = (TextColumn("sweep"), BarColumn(bar_width=24), MofNCompleteColumn(), TimeRemainingColumn(),
               TextColumn("{task.fields[failures]}"))  # fmt: skip
    with Bar(*columns, console=console, transient=True) as shown:
        task = shown.add_task("sweep", total=None, failures="")

        def update(stored: int, count: int, failed: int) -> None:
            if shown.tasks[0].total is None:
                # Points stored before this run do not count for its speed.
                shown.reset(task, total=count, completed=stored)
            shown.update(task, completed=stored, failures=f"{failed} failed" if failed else "")

        yield update


def _finished(path: Path, question: Mapping[str, str]) -> Sweep | None:
    """Return the sweep in a store if it is complete and of the same question; its medium may be read-only."""
    if not path.is_file() or not path.stat().st_size:
        return None
    kept = Store(path, write=False)
    # Another run may have made the file, and not yet its tables.
    if not kept.empty and kept.about.question == dict(question) and kept.counts().stored == kept.about.count:
        kept.verify()
        return Sweep(kept, kept.about.count)
    kept.close()
    return None


def _check_arguments(evaluation: object, over: object, executor: object, workers: object, units: object) -> None:
    """Raise InputError if an argument has the wrong type."""
    if not callable(evaluation) and not isinstance(evaluation, ManyPoints):
        raise InputError(f"{shown(evaluation)} cannot be swept: give a problem, or a function of named numbers")
    for name, given in (("over", over), ("units", {} if units is None else units)):
        if not isinstance(given, Mapping):
            raise InputError(f"{name} = {shown(given)} must be a dictionary, by the names of the quantities")
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise InputError(f"executor = {shown(executor)} must be one of concurrent.futures, or have their submit")
    if workers is not None and not is_count(workers):
        raise InputError(f"workers = {shown(workers)} must be 1 or more")
    if executor is None:
        _check_picklable(evaluation)


def _check_picklable(evaluation: object) -> None:
    """Raise InputError if an evaluation cannot be sent to another process."""
    try:
        pickle.dumps(evaluation)
    except Exception as error:
        raise InputError(
            f"{shown(evaluation)} cannot be sent to other processes ({error}): use a function of a module, not one"
            " inside another, or an instance of a class of a module; or an executor that needs no copy"
        ) from None


def _identity(evaluation: Evaluation) -> dict[str, str]:
    """Return texts that identify a function: its name, and a digest of its source or of its pickle."""
    written: Any = evaluation if hasattr(evaluation, "__qualname__") else None
    try:
        content = pickle.dumps(evaluation) if written is None else inspect.getsource(written).encode()
    except Exception:  # of any kind, from the pickle; or there is no source
        content = b""
    name = getattr(evaluation, "__qualname__", type(evaluation).__qualname__)
    return {"function": name, "text of the function": f"digest {hashlib.sha256(content).hexdigest()[:16]}"}


def _versions() -> dict[str, str]:
    packages = {**versions(), "scipy": version("scipy")}
    return {f"version of {name}": text for name, text in packages.items()}
