from typing import Any

# Compiled from native/; its twins in numpy document the arguments.
def __getattr__(name: str) -> Any: ...
