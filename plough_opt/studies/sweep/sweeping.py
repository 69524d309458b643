"""`sweep`: evaluates a function of named numbers at every point of a grid or a sample."""

import pickle
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Final

from plough_opt.core.checks import check_kind, check_switch, path_of, plain_number, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.core.process import available, progress_on
from plough_opt.core.saving import versions
from plough_opt.core.screen import Screen
from plough_opt.studies.sweep.cluster import Cluster
from plough_opt.studies.sweep.database import About, check_columns
from plough_opt.studies.sweep.engine import Engine, Progress
from plough_opt.studies.sweep.identity import digest_of
from plough_opt.studies.sweep.points import axis_of, points_of
from plough_opt.studies.sweep.pool import ProcessPool
from plough_opt.studies.sweep.result import Sweep
from plough_opt.studies.sweep.store import Store
from plough_opt.studies.sweep.work import Evaluation, ManyPoints

LIMIT: Final = 3600.0
"""Time [s] after which a point has failed. A whole optimisation takes seconds to minutes."""


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
    limit: float | None = None,
    progress: bool | Progress = False,
    question: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Sweep:
    """Evaluate a function at every point of a grid or a sample, and store the results.

    On one machine the results do not depend on the executor and the number of workers, not even in the last bit,
    because each point is computed from its own values alone.

    Args:
        evaluation: function of a dictionary of the quantities at a point. It returns named finite numbers, with the
            same names at every point. An error that it raises becomes the reason why the point failed. It must
            be picklable.
        over: name -> `Range` or list of numbers, in the units that the function expects.
        samples: number of points of a scrambled Sobol sample of the ranges, best a power of two; None for a grid.
        seed: seed of the sample.
        store: SQLite file that receives every finished point at once. Points of the same sweep that it already holds
            are not computed again, and several runs may fill it at the same time. None for a temporary file, which is
            deleted with the result.
        executor: any `concurrent.futures.Executor`, such as that of a dask client or of mpi4py; it is left running.
            Default: processes on all cores of this machine, which end with the sweep.
        workers: number of workers of the executor, so that enough tasks are submitted (default: cores of this machine).
        retry: compute the points again that failed, are undetermined, or whose rows in the store are damaged.
        limit: time [s] after which a point has failed, and its worker is replaced (default: `LIMIT`, an hour). The
            first point of each worker includes its preparation, such as compiling. Only for the processes of this
            machine, because those of another executor cannot be ended from here.
        progress: True for a bar on the error stream (lines, if that is not a terminal), or a function that is called
            with the numbers of stored points, of all points, and of failed ones.
        question: everything else that the results depend on, as texts. A store with other texts is refused. By
            default they are the function's name and a digest of its code, arguments and state.
        units: name -> unit, for quantities and results in the headings of tables.

    Raises:
        InputError: the arguments cannot be swept; the function depends on something that a store cannot recognise
            again, such as an open file; the store holds another sweep, is damaged or loses rows; the executor is
            broken, or all workers die.
        KeyboardInterrupt: the sweep was interrupted; the message says how many points are stored.
    """
    _check_arguments(evaluation, over, executor, workers, units)
    check_switch("retry", retry)
    seconds = _limit(limit, executor)
    points = points_of({name: axis_of(name, given) for name, given in over.items()}, samples, seed)
    check_columns(points.names)
    packages = {f"version of {name}": text for name, text in {**versions(), "scipy": version("scipy")}.items()}
    full_question = {**points.question(), **(question or _identity(evaluation, store)), **packages}
    store = None if store is None else path_of("the store", store)
    if not retry and store is not None and (finished := _finished(store, full_question)) is not None:
        return finished
    opened = Store(store)
    try:
        about = About.model_construct(
            names=points.names, results=(), units=dict(units or {}), question=full_question, count=points.count, next=0
        )
        opened.prepare(about, retry)
        already = opened.counts().stored
        count = workers or available()
        if already < points.count:
            with ExitStack() as stack:
                callback = progress if callable(progress) else lambda *_: None
                if progress is True:
                    callback = stack.enter_context(bar(Screen(stderr=True)))
                if executor is None:
                    used: Executor = stack.enter_context(ProcessPool(count, evaluation, seconds))
                else:
                    used = Cluster.of(executor) or executor
                Engine(evaluation, points, opened, used, count, callback).run()
        opened.finish()
    except KeyboardInterrupt:
        done = opened.counts().stored
        opened.close()
        place = f"in '{store}': the same sweep continues from there"
        where = "lost, because there is no store" if store is None else place
        raise KeyboardInterrupt(f"{done} of {points.count} points are {where}") from None
    except BaseException:
        opened.close()
        raise
    return Sweep(opened, already)


@contextmanager
def bar(screen: Screen) -> Iterator[Progress]:
    """Show the progress of a sweep, as a bar on a terminal or as lines; yield the function that updates it."""
    with progress_on(screen) as show:
        yield lambda stored, count, failed: show(
            f"sweep: {stored} of {count} points{f', {failed} failed' if failed else ''}", stored / count
        )


def _finished(path: Path, question: Mapping[str, str]) -> Sweep | None:
    """Return the sweep in a store if it is complete and has this question; the medium may be read-only."""
    if not path.is_file() or not path.stat().st_size:
        return None
    found = Store(path, write=False)
    # The store may be empty, because another run has created the file and not yet its tables.
    if not found.empty and found.about.question == dict(question) and found.counts().stored == found.about.count:
        found.verify()
        return Sweep(found, found.about.count)
    found.close()
    return None


def _check_arguments(evaluation: object, over: object, executor: object, workers: object, units: object) -> None:
    """Raise InputError if an argument has the wrong type."""
    if not callable(evaluation) and not isinstance(evaluation, ManyPoints):
        raise InputError(f"{shown(evaluation)} cannot be swept: use a problem, or a function of named numbers")
    check_kind("over", over, Mapping, "a dictionary with names as keys")
    check_kind("units", units, Mapping | None, "a dictionary with names as keys")
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise InputError(
            f"executor = {shown(executor)} must be an executor of concurrent.futures, or have a method submit"
        )
    if workers is not None and not is_count(workers):
        raise InputError(f"workers = {shown(workers)} must be 1 or more")
    if executor is not None:
        return
    try:
        pickle.dumps(evaluation)
    except Exception as error:
        raise InputError(
            f"{shown(evaluation)} cannot be sent to other processes ({error}): use a function at the top level of a"
            " module, an instance of a class at the top level, or an executor that works in this process"
        ) from None


def _limit(limit: object, executor: object) -> float:
    """Return the time limit [s] of a point.

    Raises:
        InputError: it is not a number above 0, or an executor is given too.
    """
    if limit is None:
        return LIMIT
    if executor is not None:
        raise InputError("limit is for the processes of this machine: remove it, or the executor")
    seconds = plain_number("the limit of a point", limit)
    if not seconds > 0.0:
        raise InputError(f"limit = {shown(limit)} must be a time above 0 s")
    return seconds


def _identity(evaluation: Evaluation, store: object) -> dict[str, str]:
    """Return texts that identify a function: its name and, for a store, a digest of all that it depends on."""
    name = getattr(evaluation, "__qualname__", type(evaluation).__qualname__)
    return {"function": name} if store is None else {"function": name, "code of the function": digest_of(evaluation)}
