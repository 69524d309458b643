"""Optimisers side by side: each in a thread of its own, their designs evaluated together.

An optimiser's designs do not depend on its neighbours', so that results are the same however threads are scheduled.
"""

import threading

import numpy as np


class Lockstep:
    """Collects what threads ask for until all that still run have asked, then evaluates it at once."""

    def __init__(self, evaluate):
        """Take a function from rows to a tuple of arrays, whose last axis is over the rows."""
        self._evaluate = evaluate
        self._condition = threading.Condition()
        self._running, self._asked, self._answers, self._round = 0, {}, {}, 0

    def __call__(self, rows):
        """Return the values of rows; called by an optimiser."""
        with self._condition:
            own, at = threading.get_ident(), self._round
            self._asked[own] = rows
            if len(self._asked) == self._running:
                self._answer()
            self._condition.wait_for(lambda: self._round > at)
            return self._answers.pop(own)

    def _answer(self):
        owners = list(self._asked)
        ends = np.cumsum([len(self._asked[owner]) for owner in owners])[:-1]
        values = self._evaluate(np.vstack([self._asked[owner] for owner in owners]))
        parts = [np.split(value, ends, axis=-1) for value in values]
        for k, owner in enumerate(owners):
            self._answers[owner] = tuple(part[k] for part in parts)
        self._asked, self._round = {}, self._round + 1
        self._condition.notify_all()

    def run(self, optimisers):
        """Return what functions without arguments return, each of which may call this object."""
        results = [None] * len(optimisers)

        def work(k):
            try:
                results[k] = optimisers[k]()
            except Exception as error:
                results[k] = error
            with self._condition:
                self._running -= 1
                if self._asked and len(self._asked) == self._running:
                    self._answer()

        self._running = len(optimisers)
        threads = [threading.Thread(target=work, args=(k,)) for k in range(len(optimisers))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for result in results:
            if isinstance(result, Exception):
                raise result
        return results
