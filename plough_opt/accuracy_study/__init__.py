"""What accuracy costs: error against time for every method that can do a scene or a design.

The folder bears the name of its verb, and is called like it: ``plough_opt.accuracy_study(scene, duration)`` is
`plough_opt.accuracy_study.study.accuracy_study`.
"""

from __future__ import annotations

import sys
import types
from typing import Any


class _Verb(types.ModuleType):
    """A module that can be called."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Call `plough_opt.accuracy_study.study.accuracy_study`, imported when first used."""
        from plough_opt.accuracy_study.study import accuracy_study

        return accuracy_study(*arguments, **options)


sys.modules[__name__].__class__ = _Verb
