"""Tables of calls that are refused."""

import pytest


def refusals(error, *rows):
    """Return a test of calls and words: every call raises the error with a message in which the words are found."""

    @pytest.mark.parametrize(("call", "words"), rows, ids=[words for _, words in rows])
    def test(call, words):
        with pytest.raises(error, match=words):
            call()

    return test
