"""Optional packages: imported here and nowhere else inside functions, so that a missing one is named with its extra."""

import importlib
import importlib.util
from types import ModuleType


class MissingExtra(ImportError):
    """A package of an extra is not installed; the message is one line that says which extra to install."""


def require(module: str, extra: str) -> ModuleType:
    """Import an optional module by its full name; a :class:`MissingExtra` if it or what it imports is missing."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        missing = error.name or module
        raise _missing(f"importing {missing}", missing, extra) from None


def require_all(user: str, extra: str, *modules: str) -> None:
    """Refuse to go on, before long work, unless all of some top-level modules can be found; none is imported."""
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise _missing(user, module, extra)


def _missing(user: str, module: str, extra: str) -> MissingExtra:
    return MissingExtra(f'{user} needs the extra "{extra}": pip install "fmsync[{extra}]"', name=module)
