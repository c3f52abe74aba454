"""The recipes: one script each, an algorithm read from top to bottom.

A recipe imports torchgrasp and nothing beside itself. Installed, they are `torchgrasp.recipes`.
"""
