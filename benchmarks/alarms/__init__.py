"""How well the node's alarm is aimed: silent while a robot stays what it is, soon there when it has changed."""
