"""Optional packages: imported here and nowhere else inside functions, so that a missing one is named with its extra."""

import importlib
import importlib.util
from types import ModuleType


class MissingExtra(ImportError):
    """A package of an extra is not installed; the message is one line that says which extra to install."""


def require(module: str, extra: str) -> ModuleType:
    """Import an optional module.

    Parameters
    ----------
    module
        Full name of the module, such as ``"matplotlib.pyplot"``.
    extra
        Extra of this project that installs it: ``"shapes"``, ``"viz"`` or ``"bench"``.

    Raises
    ------
    MissingExtra
        The module, or one that it imports, is not installed. It is an ``ImportError`` and names the extra.

    Examples
    --------
    >>> require("json", "shapes").dumps([1, 2])
    '[1, 2]'
    >>> require("no_such_package", "shapes")
    Traceback (most recent call last):
    fmsync.extras.MissingExtra: importing no_such_package needs the extra "shapes": pip install "fmsync[shapes]"
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        missing = error.name or module
        raise _missing(f"importing {missing}", missing, extra) from None


def require_all(user: str, extra: str, *modules: str) -> None:
    """Refuse to go on unless every one of some top-level modules can be found; none of them is imported.

    A package that is of no use without an extra calls this before its other imports, so that a missing module is
    reported at once and not after long work.

    Parameters
    ----------
    user
        What needs the modules, for the message.
    extra
        Extra of this project that installs them.
    *modules
        Their names, without dots.

    Raises
    ------
    MissingExtra
        One of them is not installed. It is an ``ImportError`` and names the extra.

    Examples
    --------
    >>> require_all("fmsync.viz", "viz", "json", "no_such_package")
    Traceback (most recent call last):
    fmsync.extras.MissingExtra: fmsync.viz needs the extra "viz": pip install "fmsync[viz]"
    """
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise _missing(user, module, extra)


def _missing(user: str, module: str, extra: str) -> MissingExtra:
    return MissingExtra(f'{user} needs the extra "{extra}": pip install "fmsync[{extra}]"', name=module)
