"""Control with the identified model: feed-forward efforts, and their adaptation to a payload."""
