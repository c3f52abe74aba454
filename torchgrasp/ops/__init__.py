"""Point operations in pure torch: sampling, neighbourhoods, grouping.

`reference` spells each operation out as its definition; `points` gives the same answers, bit for
bit, on batches and fast. Both run wherever torch runs; nothing is compiled.
"""

from torchgrasp.ops.points import ball_query as ball_query
from torchgrasp.ops.points import farthest_point_sample as farthest_point_sample
from torchgrasp.ops.points import group as group
