"""An executor for a dask cluster that reports dead workers and an empty cluster.

With dask's own executor a future never ends if fetching its result fails, and nothing is reported if no worker is left.
"""

from __future__ import annotations

import asyncio
import time
from concurrent.futures import CancelledError, Executor, Future
from typing import TYPE_CHECKING, Any, Final

from plough_opt.core.errors import InputError
from plough_opt.studies.sweep.pool import STORED, WorkerDied

if TYPE_CHECKING:
    import distributed

# Time [s] for which a cluster may be without workers, which may be restarting.
_PATIENCE: Final = 40.0
# Time [s] between two checks for workers; also the time limit for the scheduler's answer.
_CHECK_EVERY: Final = 3.0


class Cluster(Executor):
    """The executor of a dask client."""

    def __init__(self, client: distributed.Client, options: dict[str, Any]) -> None:
        """Take a client and the options of its executor."""
        self._client, self._options = client, options
        self._checked = self._seen = time.monotonic()

    @classmethod
    def of(cls, executor: Executor) -> Cluster | None:
        """Return the cluster behind an executor of dask, or None for other executors."""
        if type(executor).__module__ != "distributed.cfexecutor":
            return None
        # dask has no public names for these.
        return cls(executor._client, executor._kwargs)  # type: ignore[attr-defined]

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call, as any executor does."""
        future: Future[Any] = Future()
        task = self._client.submit(fn, *args, **self._options, **kwargs)
        assert self._client.loop is not None
        self._client.loop.add_callback(_carry, task, future)
        future.add_done_callback(lambda future: task.cancel() if future.cancelled() else None)
        return future

    def check(self) -> None:
        """Check whether there are workers, unless this was checked a moment ago.

        Raises:
            InputError: for `_PATIENCE` there have been no workers, or no answers from the scheduler.
        """
        if time.monotonic() - self._checked < _CHECK_EVERY:
            return
        assert self._client.scheduler is not None
        try:
            workers = self._client.sync(self._client.scheduler.ncores, callback_timeout=_CHECK_EVERY)
        except (OSError, TimeoutError):
            workers = {}
        now = self._checked = time.monotonic()
        if workers:
            self._seen = now
        elif now - self._seen > _PATIENCE:
            raise InputError(f"the cluster has had no workers for {now - self._seen:.0f} s: start some; {STORED}")


async def _carry(task: distributed.Future[Any], future: Future[Any]) -> None:
    """Pass the result or the error of a task to a future."""
    error: BaseException
    try:
        result = await task
    except (asyncio.CancelledError, CancelledError):
        error = InputError(f"the cluster's scheduler is gone, or has dropped a task; {STORED}")
    except Exception as reason:
        error = reason
        if type(reason).__name__ == "KilledWorker":  # it killed more workers than dask allows
            allowed: int = reason.allowed_failures  # type: ignore[attr-defined]
            error = WorkerDied("dask does not say how", allowed + 1)
    else:
        if future.set_running_or_notify_cancel():
            future.set_result(result)
        return
    if future.set_running_or_notify_cancel():
        future.set_exception(error)
