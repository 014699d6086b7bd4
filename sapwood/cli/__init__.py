"""The commands: one file for each; :mod:`sapwood.cli.main` has the entry points.

Nothing heavy may be imported at the top of these files: the help has to appear at once.
"""
