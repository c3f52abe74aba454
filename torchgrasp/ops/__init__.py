"""Point operations on tensors: sampling, neighbourhoods, grouping, pooling. Nothing else, and no tensordict.

`definitions` spells each operation out as its definition; the functions here give the same answers, bit
for bit, on batches and fast, on the CPU (`dense`) and on CUDA devices (`kernels`). Nothing is compiled
at installation.
"""

from torchgrasp.ops.points import ball_query as ball_query
from torchgrasp.ops.points import farthest_point_sample as farthest_point_sample
from torchgrasp.ops.points import group as group
