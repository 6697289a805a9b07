"""``python -m geomid_ros`` is ``geomid``."""

from geomid_ros.commands import main

if __name__ == "__main__":
    main()
