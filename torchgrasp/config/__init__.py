"""From a configuration to the parts that it names: typed values, checks, builders.

Beside the recipes the only place that sees a `cfg`.
"""
