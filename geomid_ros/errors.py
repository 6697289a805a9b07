"""Exception classes. Each message states the problem, the expectation, and the remedy."""

from __future__ import annotations

import difflib
import resource
from collections.abc import Collection, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager

_LONGEST = 4000  # characters in a message
_NO_MEMORY = ("failed to map segment", "annot allocate memory", "ould not allocate memory", "Unable to allocate")
_TOO_LITTLE_MEMORY = (
    "too little memory: geomid needs 1 GB plus the size of its recordings; check limits such as ulimit -v"
)
_LONGEST_GUESS = 200  # characters in a name
_LEAST_MEMORY = 500_000_000  # bytes of address space: with less, libraries crash or hang
_ON_PYPI = {
    "backports": "backports.zstd",
    "collada": "pycollada",
    "pinocchio": "pin",
    "rclpy": "'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces, or source a workspace of ROS 2",
    "yaml": "PyYAML",
}
"""Arguments of ``pip install`` for libraries that are imported under another name."""


class GeomidError(Exception):
    """Base class of all errors that this package raises on purpose; commands print them without a traceback.

    Messages quote text from outside. Control characters, which a terminal would obey, are therefore escaped, and the
    middle of long messages is cut out.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class InputError(GeomidError):
    """Input from outside (file, topic, option, parameter) that cannot be used. Its message is one line."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def printable(message: str) -> str:
    """Make a message safe for a terminal: escape control characters, and cut the middle of a long message."""
    if len(message) > _LONGEST:
        message = f"{message[: _LONGEST // 2]} ... {message[-_LONGEST // 2 :]}"
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in message)


def check_memory() -> None:
    """Raise GeomidError if the process may not use enough memory; import hashlib while there is some: if it fails
    later, it logs a traceback for each hash."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _LEAST_MEMORY:
        raise GeomidError(_TOO_LITTLE_MEMORY)
    import hashlib  # noqa: F401, PLC0415


def error_message(error: Exception) -> str:
    """Message for the user about an error that ends a program: one of this package, lack of memory, or a library that
    is not installed. Empty for any other, which is a mistake in this package."""
    if isinstance(error, GeomidError):
        return str(error)
    return _TOO_LITTLE_MEMORY if _is_lack_of_memory(error) else _missing_library(error)


def _is_lack_of_memory(error: BaseException) -> bool:
    """True if an error or one of its causes reports a lack of memory. Libraries use different words for it, so their
    messages are searched."""
    causes: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in causes:
        causes.append(cause)
        cause = cause.__cause__ or cause.__context__
    return any(isinstance(e, MemoryError) or any(word in str(e) for word in _NO_MEMORY) for e in causes)


def _missing_library(error: BaseException) -> str:
    """Return advice if the error is a library that is not installed; empty for any other error."""
    name = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if not name or name == __package__:
        return ""
    return f"{name} is not installed: pip install {_ON_PYPI.get(name, name)}"


def one_line(text: str) -> str:
    """Make text from outside safe as one line of a terminal, log or message: line ends are escaped too."""
    return text if text.isprintable() and len(text) <= _LONGEST else printable(text).replace("\n", "\\n")


def unknown_name(kind: str, name: str, valid: Iterable[str]) -> InputError:
    """Return the error for an unknown name; it lists the valid names and suggests the closest."""
    names = sorted(valid)
    # Comparing two names takes time proportional to the product of their lengths.
    short = [valid for valid in names if len(valid) <= _LONGEST_GUESS]
    close = difflib.get_close_matches(name, short, n=1) if len(name) <= _LONGEST_GUESS else []
    guess = f" Did you mean '{close[0]}'?" if close else ""
    return InputError(f"unknown {kind} '{name}'.{guess} Valid: {', '.join(names) or '(none)'}")


def check_name(kind: str, name: str, valid: Collection[str], where: str = "") -> None:
    """Raise the error of :func:`unknown_name`, beginning with ``where``, for a name that is not ``valid``."""
    if name not in valid:
        error = unknown_name(kind, name, valid)
        raise InputError(f"{where}: {error}") if where else error


@contextmanager
def refusing(
    sentence: str, *errors: type[Exception], advice: str = "", kind: type[GeomidError] = InputError
) -> Iterator[None]:
    """Turn these errors in the block into one with the ``sentence``, the reason in parentheses, and the ``advice``."""
    try:
        yield
    except errors as error:
        reason = " ".join(str(getattr(error, "strerror", None) or error).split())
        raise kind(f"{sentence} ({reason}){f'; {advice}' if advice else ''}") from error


def needing_ros(what: str) -> AbstractContextManager[None]:
    """Turn an ImportError in the block into an InputError: ``what``, in words, needs ROS."""
    return refusing(f"{what} needs ROS 2, which cannot be imported", ImportError)
