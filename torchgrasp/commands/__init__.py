"""The command line: a module for each command, imported only when it is asked for.

Nothing else imports from here.
"""
