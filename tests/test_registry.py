"""Methods found by name."""

import pytest

from fmsync.registry import Registry


@pytest.fixture
def registry():
    registry = Registry("baker", given=("flour",))

    @registry.register("rye")
    def rye(flour, *, hours=3):
        return flour, hours

    @registry.register("oat")
    class Oat:
        def __init__(self, flour):
            pass

    return registry


def test_entries_come_with_the_options_they_know(registry):
    assert sorted(registry) == ["oat", "rye"]
    entry, known = registry.find("rye", {"hours": 2})
    assert entry(1, hours=2) == (1, 2)
    assert known == ["hours"]
    assert registry.find("oat", {})[1] == []


@pytest.mark.parametrize(
    ("method", "options", "message"),
    [
        ("rie", {}, "method: no baker is called 'rie'; did you mean rye?"),
        ("spelt cake", {}, "method: no baker is called 'spelt cake'; known: oat, rye"),
        ("rye", {"salt": 1}, "salt: 'rye' has no such option; it takes hours"),
        ("oat", {"salt": 1}, "salt: 'oat' has no such option; it takes none"),
        ("rye", {"flour": 1}, "flour: 'rye' has no such option; it takes hours"),
    ],
)
def test_unknown_names_are_refused_with_the_known_ones(registry, method, options, message):
    with pytest.raises(ValueError, match=message.replace("?", r"\?")):
        registry.find(method, options)
