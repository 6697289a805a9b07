"""The simulator against pinocchio, which it does not use. A package, so that its modules may share ``independent``."""
