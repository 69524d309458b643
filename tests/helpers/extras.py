"""Libraries of the extra `full`, without which tests are skipped."""

import pytest


def needs(name):
    """Return a library's module, or skip the test with a sentence that names the extra."""
    return pytest.importorskip(name, reason=f"{name} is not installed: make test, or pip install -e '.[full]'")
