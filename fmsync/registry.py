"""Methods found by name."""

import difflib
import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import TypeVar

Entry = TypeVar("Entry", bound=Callable[..., object])


class Registry(dict[str, Entry]):
    """Callables by name; ``given`` are the arguments that every one takes and no user passes as an option."""

    def __init__(self, kind: str, given: tuple[str, ...]) -> None:
        super().__init__()
        self._kind, self._given = kind, given

    def register(self, name: str) -> Callable[[Entry], Entry]:
        """Decorator that keeps what it decorates under a name."""

        def keep(entry: Entry) -> Entry:
            self[name] = entry
            return entry

        return keep

    def find(self, method: str, options: Mapping[str, object]) -> tuple[Entry, list[str]]:
        """The entry and the options it knows; a ValueError with the nearest names, or with the options it does know."""
        if method not in self:
            raise ValueError(f"method: no {self._kind} is called {method!r}; {near_names(method, self)}")
        known = [name for name in inspect.signature(self[method]).parameters if name not in self._given]
        if unknown := sorted(set(options) - set(known)):
            raise ValueError(f"{unknown[0]}: {method!r} has no such option; it takes {', '.join(known) or 'none'}")
        return self[method], known


def near_names(name: str, known: Iterable[str]) -> str:
    """What an error says after a name that is not known."""
    close = difflib.get_close_matches(name, list(known))
    return f"did you mean {' or '.join(close)}?" if close else f"known: {', '.join(sorted(known))}"
