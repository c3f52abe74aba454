"""What people look at: pages, plots, films and the live viewer.

Nothing is measured here: numbers come from evaluation and runs.
"""
