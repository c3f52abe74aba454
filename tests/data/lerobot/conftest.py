"""What is no test: a script for an environment of its own, where LeRobot itself is installed."""

collect_ignore = ["with_real_library.py"]
