"""One family of errors. Each message says what was found, what was expected and what to do about it."""

from __future__ import annotations

import difflib
import resource
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

_LONGEST = 4000  # characters of a message
_NO_MEMORY = ("failed to map segment", "annot allocate memory", "ould not allocate memory", "Unable to allocate")
TOO_LITTLE_MEMORY = (
    "too little memory: geomid needs 1 GB plus the size of its recordings; check limits such as ulimit -v"
)
"""What is said then."""
_LONGEST_GUESS = 200  # characters of a name
_LEAST_MEMORY = 500_000_000  # bytes of addresses: with less, libraries crash or hang
_ON_PYPI = {
    "backports": "backports.zstd",
    "collada": "pycollada",
    "pinocchio": "pin",
    "rclpy": "'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces, or source a workspace of ROS 2",
    "yaml": "PyYAML",
}
"""What installs libraries that are imported under another name."""


class GeomidError(Exception):
    """Anything this package raises on purpose; commands print it without a traceback.

    Messages quote what came from outside: control characters, which a terminal would obey, are shown as their codes,
    and of what is too long the middle is left out.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class InputError(GeomidError):
    """Input from outside (file, topic, option, parameter) that cannot be used. Its message is one line."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def printable(message: str) -> str:
    """The message as a terminal may have it: no control characters, and not too long."""
    if len(message) > _LONGEST:
        message = f"{message[: _LONGEST // 2]} ... {message[-_LONGEST // 2 :]}"
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in message)


def check_memory() -> None:
    """Raise GeomidError where the process may not have enough."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _LEAST_MEMORY:
        raise GeomidError(TOO_LITTLE_MEMORY)


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an error, or one that it comes from, says that there is too little memory: libraries that are loaded then
    each have words of their own."""
    causes: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in causes:
        causes.append(cause)
        cause = cause.__cause__ or cause.__context__
    return any(isinstance(each, MemoryError) or any(word in str(each) for word in _NO_MEMORY) for each in causes)


def load_hashes() -> None:
    """Load Python's hashes while there is room: later, without any, their module logs a traceback for each of them."""
    import hashlib  # noqa: F401, PLC0415


def missing_library(error: BaseException) -> str:
    """What to do when a library is not installed; empty for any other error."""
    name = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if not name or name == __package__:
        return ""
    return f"{name} is not installed: pip install {_ON_PYPI.get(name, name)}"


def one_line(text: str) -> str:
    """Text from outside as one line of a terminal, a log or a message may have it: line ends are codes, too."""
    return text if text.isprintable() and len(text) <= _LONGEST else printable(text).replace("\n", "\\n")


def unknown_name(kind: str, name: str, valid: Iterable[str]) -> InputError:
    """The error for a name that does not exist; it lists those that do and guesses which was meant."""
    names = sorted(valid)
    # To compare two names takes the product of their lengths.
    short = [valid for valid in names if len(valid) <= _LONGEST_GUESS]
    close = difflib.get_close_matches(name, short, n=1) if len(name) <= _LONGEST_GUESS else []
    guess = f" Did you mean '{close[0]}'?" if close else ""
    return InputError(f"unknown {kind} '{name}'.{guess} Valid: {', '.join(names) or '(none)'}")


@contextmanager
def needing_ros(what: str) -> Iterator[None]:
    """Import what needs ROS. Raises InputError where there is none; ``what`` needs it, in words."""
    try:
        yield
    except ImportError as error:
        raise InputError(f"{what} needs ROS 2, which cannot be imported ({error})") from error
